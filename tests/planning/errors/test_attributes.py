"""Misspelt attributes are refused, when they are read and when they are assigned, with a "did you mean"."""

from __future__ import annotations

import copy
import pickle

import pytest
from testing.wrong_arguments import cart, refused, rest_to_rest

import gnc_opt as go
from gnc_opt.argument_checks import suggest_keywords


def test_attributes() -> None:
    with refused(go.UnknownAttributeError, "phase 'leg' has no 'intial'", "did you mean 'initial'?"):
        rest_to_rest()[1].intial(q=1.0)  # type: ignore[attr-defined]
    with refused(go.UnknownAttributeError, "model 'cart' has no 'sate'", "did you mean 'state'?"):
        cart().sate("x")  # type: ignore[attr-defined]
    with refused(
        go.UnknownAttributeError, "problem 'rest to rest' has no 'minimise'", "did you mean 'minimize'?"
    ):
        rest_to_rest()[0].minimise(0.0)  # type: ignore[attr-defined]

    problem, _ = rest_to_rest()
    with refused(go.UnknownAttributeError, "problem 'rest to rest' has no 'initial'", "belongs to a Phase"):
        problem.initial(q=1.0)  # type: ignore[attr-defined]

    _, leg = rest_to_rest()
    with refused(go.UnknownAttributeError, "phase 'leg' has no 'minimize'", "belongs to a Problem"):
        leg.minimize(leg.final_time)  # type: ignore[attr-defined]
    with refused(go.UnknownAttributeError, "problem 'rest to rest' has no 'ode'", "belongs to a Model"):
        rest_to_rest()[0].ode({})  # type: ignore[attr-defined]
    with refused(go.UnknownAttributeError, "phase 'leg' has no 'bound'", "did you mean 'bounds'?"):
        leg.bound = {"a": (-1.0, 1.0)}  # type: ignore[attr-defined]
    with refused(go.UnknownAttributeError, "phase 'leg'", "bounds(...)"):
        leg.bounds = {"a": (-1.0, 1.0)}  # type: ignore[method-assign, assignment]

    problem, leg = rest_to_rest()
    with refused(go.UnknownAttributeError, "problem 'rest to rest'", "minimize(...)"):
        problem.minimize = leg.final_time  # type: ignore[method-assign]

    model = cart()
    with refused(go.UnknownAttributeError, "'states' of model 'cart'", "declarations"):
        model.states = ()  # type: ignore[assignment, misc]


def test_the_error_is_an_attribute_error_too() -> None:
    _, leg = rest_to_rest()
    assert not hasattr(leg, "intial")
    with pytest.raises(AttributeError):
        _ = leg.intial  # type: ignore[attr-defined]


def test_copies_work() -> None:
    problem, leg = rest_to_rest()
    twin = copy.copy(leg)
    assert twin.name == "leg" and twin.model is leg.model
    assert problem.with_final(q=0.5).phases["leg"].numbers.final.lower[0] == 0.5


def test_protocols_that_are_missing_are_asked_for_without_a_search_for_what_was_meant() -> None:
    _, leg = rest_to_rest()
    with pytest.raises(AttributeError) as caught:
        leg.__deepcopy__  # type: ignore[attr-defined]  # noqa: B018
    assert type(caught.value) is AttributeError


def test_subclasses_may_have_attributes_of_their_own() -> None:
    class Cart(go.Model):
        def __init__(self) -> None:
            super().__init__("my cart")
            self.q = self.state("q")
            self.ode({self.q: self.control("a")})

    assert Cart().states.names == ("q",)
    with pytest.raises(go.UnknownAttributeError, match="did you mean 'state'"):
        Cart().stat  # type: ignore[attr-defined]  # noqa: B018


def test_misspelt_attribute_of_a_result_is_an_error() -> None:
    solution = go.solve(rest_to_rest()[0], mesh="2x3", tol=None)
    for name, remedy in [
        ("cost", "solution has no 'cost': use objective."),
        ("states", "did you mean 'state'?"),
        ("pass_rate", "it belongs to a Campaign."),
        ("whatever", "known: accuracy, bound,"),
    ]:
        with refused(go.UnknownAttributeError, remedy):
            getattr(solution, name)
    with refused(go.UnknownAttributeError, "phase solution 'leg' has no 'final_tim'"):
        solution.phase().final_tim  # type: ignore[attr-defined]  # noqa: B018
    with pytest.raises(AttributeError):
        solution.objectve = 1.0  # type: ignore[attr-defined]
    with pytest.raises(AttributeError):
        solution.objective = 1.0  # type: ignore[misc]
    with pytest.raises(TypeError, match="max_iteration"):
        go.SolverOptions(max_iteration=10)  # type: ignore[call-arg]


def test_errors_survive_pickling() -> None:
    """Parallel campaigns send errors between processes."""
    with pytest.raises(go.GncOptError) as caught:
        rest_to_rest()[1].initial(vv=0.0)
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value) and type(again) is type(caught.value)


def test_unknown_keywords_get_a_suggestion() -> None:
    problem = go.Problem("probe")
    leg = problem.phase("leg", cart())
    for call, suggestion in [
        (lambda: leg.time(initia=0.0), "'initia': did you mean 'initial'"),
        (lambda: leg.path("fast", 1.0, uper=1.0), "'uper': did you mean 'upper'"),
        (lambda: problem.parameter("k", lowr=1.0), "'lowr': did you mean 'lower'"),
        (lambda: go.solve(problem, mash="3x3"), "'mash': did you mean 'mesh'"),
    ]:
        with pytest.raises(TypeError, match=suggestion):
            call()


def test_type_errors_inside_a_method_stay_as_they_are() -> None:
    def wrong(**_: int) -> None:
        raise TypeError("inner() got an unexpected keyword argument 'b'")

    with pytest.raises(TypeError, match=r"'b'$"):
        suggest_keywords(wrong)(a=1)


def test_dir_lists_what_users_may_call() -> None:
    leg = go.Problem("probe").phase("leg", cart())
    for thing in (go, leg, go.Problem("other"), go.Model("empty")):
        assert not [name for name in dir(thing) if name.startswith("_")]
    assert {"bounds", "path", "final_state", "integral"} <= set(dir(leg))
    assert not {"known_ends", "numbers", "clone", "linked_states"} & set(dir(leg))
    assert all(hasattr(leg, name) for name in dir(leg))
