"""Functional mock-up units: another maker's tool reads, checks and steps them, and gets the law of Python."""

import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from testing.c_compiler import COMPILER, FLAGS, follower, holder, needs_compiler

import gnc_opt as go
from gnc_opt.control import export_fmu
from gnc_opt.control import fmu_export as functional_mockup

fmpy = pytest.importorskip("fmpy", reason="fmpy (extra peers) is not installed")
pytestmark = needs_compiler

START, DT = 0.5, 0.1


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    return export_fmu(follower(), tmp_path_factory.mktemp("fmu") / "follower.fmu", dt=DT)


class Slave:
    """A unit of `fmpy` in co-simulation, from START on."""

    def __init__(self, unit, folder):
        self.description = fmpy.read_model_description(str(unit.file), validate=True)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        identifier = self.description.coSimulation.modelIdentifier
        self.fmu = fmpy.fmi2.FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=fmpy.extract(str(unit.file), str(folder)),
            modelIdentifier=identifier,
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=START)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.t, self.outputs = START, [v for v in self.description.modelVariables if v.causality == "output"]

    def step(self, x, h=DT):
        """Set the inputs, step by h, return the commands."""
        inputs = [v.valueReference for v in self.description.modelVariables if v.causality == "input"]
        self.fmu.setReal(inputs, [float(v) for v in x])
        self.fmu.doStep(self.t, h)
        self.t += h
        return np.array(self.fmu.getReal([v.valueReference for v in self.outputs if v.type == "Real"]))

    def end(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


@pytest.fixture
def slave(unit, tmp_path):
    found = Slave(unit, tmp_path)
    yield found
    found.end()


def python(controller, states):
    z, commands = None, []
    for k, x in enumerate(states):
        u, z = controller(START + k * DT, x, z, DT)
        commands.append(u)
    return np.array(commands)


@pytest.mark.parametrize("design", [follower, holder])
def test_unit_steps_as_the_law_of_python(design, tmp_path):
    controller = design(DT)
    slave = Slave(export_fmu(controller, tmp_path / "new" / "law.fmu"), tmp_path / "unpacked")
    states = np.random.default_rng(3).normal(size=(60, 2))
    found = np.array([slave.step(x) for x in states])
    slave.end()
    expected = python(controller, states)
    assert np.ptp(expected) > 0.9
    assert np.allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_description_names_what_the_model_names(unit, slave):
    variables = {v.name: v for v in slave.description.modelVariables}
    assert {name: (v.type, v.causality, v.unit) for name, v in variables.items()} == {
        "q": ("Real", "input", "rad"),
        "v": ("Real", "input", "rad/s"),
        "a": ("Real", "output", "1/s^2"),
        "invalid": ("Boolean", "output", None),
    }
    experiment = slave.description.defaultExperiment
    assert (experiment.startTime, experiment.stopTime, experiment.stepSize) == ("0.5", "3.53", "0.1")
    assert unit.binary is not None


def test_a_command_is_held_between_samples(slave):
    x = [[0.9, 0.1], [0.4, -0.3], [0.2, 0.5]]
    expected = python(follower(), [x[0], x[2]])
    half = [slave.step(x[0], DT / 2), slave.step(x[1], DT / 2), slave.step(x[2], DT / 2)]
    assert np.allclose(half, [expected[0], expected[0], expected[1]], rtol=1e-12)


def test_a_long_step_runs_every_sample_in_it(slave):
    x = [0.9, 0.1]
    assert np.allclose(slave.step(x, 3 * DT), python(follower(), [x] * 3)[-1], rtol=1e-12)


def test_time_does_not_run_away_from_its_sums(slave):
    states = np.random.default_rng(4).normal(size=(300, 2))
    found = [slave.step(x) for x in states]  # t is a sum of 300 rounded tenths
    assert np.allclose(found, python(follower(), states), rtol=1e-12, atol=1e-12)


def test_state_can_be_kept_and_taken_up_again(tmp_path):
    controller = holder(DT)  # with an integral, so that the past counts
    slave = Slave(export_fmu(controller, tmp_path / "law.fmu"), tmp_path / "unpacked")
    states = np.random.default_rng(5).normal(size=(4, 2))
    slave.step(states[0])
    kept, t = slave.fmu.getFMUState(), slave.t
    bytes_of_it = slave.fmu.serializeFMUState(kept)
    first = [slave.step(x) for x in states[1:]]
    slave.fmu.setFMUState(slave.fmu.deserializeFMUState(bytes_of_it))
    slave.t = t
    again = [slave.step(x) for x in states[1:]]
    slave.fmu.freeFMUState(kept)
    slave.end()
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])


def test_lost_samples_raise_the_alarm(slave):
    alarm = [slave.references["invalid"]]
    slave.step([0.5, 0.0])
    assert slave.fmu.getBoolean(alarm) == [0]
    for _ in range(5):
        command = slave.step([np.nan, 0.0])
    assert slave.fmu.getBoolean(alarm) == [1]
    assert np.all(np.isfinite(command))


def test_steps_that_leave_samples_out_or_go_back_are_errors(slave):
    slave.step([0.5, 0.0])
    with pytest.raises(fmpy.fmi1.FMICallException):
        slave.fmu.doStep(START + 5 * DT, DT)  # leaves samples out
    with pytest.raises(fmpy.fmi1.FMICallException):
        slave.fmu.doStep(START + DT, -DT)


def test_another_guid_is_refused(unit, slave, tmp_path):
    folder = fmpy.extract(str(unit.file), str(tmp_path / "other"))
    other = fmpy.fmi2.FMU2Slave(guid="0", unzipDirectory=folder, modelIdentifier=unit.identifier)
    with pytest.raises(Exception, match=r"(?i)instantiate"):
        other.instantiate()


def test_units_of_sources_compile_without_a_warning(tmp_path):
    unit = export_fmu(follower(), tmp_path / "law.fmu", dt=DT, binary=False)
    assert unit.binary is None
    assert not any(name.startswith("binaries") for name in zipfile.ZipFile(unit.file).namelist())
    folder = Path(fmpy.extract(str(unit.file), str(tmp_path / "unpacked")))
    listed = ElementTree.parse(folder / "modelDescription.xml").iterfind("CoSimulation/SourceFiles/File")
    sources = [file.get("name") for file in listed]
    assert len(sources) == 2
    subprocess.run(
        [COMPILER, *FLAGS, "-c", *(str(folder / "sources" / name) for name in sources)],
        check=True,
        cwd=tmp_path,
    )
    # the same controller, the same bytes
    again = export_fmu(follower(), tmp_path / "again" / "law.fmu", dt=DT, binary=False)
    assert again.file.read_bytes() == unit.file.read_bytes()


def test_bad_input_is_reported(tmp_path, monkeypatch):
    with pytest.raises(go.ArgumentError, match=r"'<name>\.fmu'"):
        export_fmu(follower(), tmp_path / "law.zip", dt=DT)
    with pytest.raises(go.ArgumentError, match="C function"):
        export_fmu(follower(), tmp_path / "my law.fmu", dt=DT)
    with pytest.raises(go.ArgumentError, match="a source file of every unit"):
        export_fmu(follower(), tmp_path / "fmu_law.fmu", dt=DT)
    with pytest.raises(go.ArgumentError, match="give dt"):
        export_fmu(follower(), tmp_path / "law.fmu")
    monkeypatch.setattr(sys, "platform", "plan9")
    with pytest.raises(go.GncOptError, match="binary=False"):
        export_fmu(follower(), tmp_path / "law.fmu", dt=DT)
    monkeypatch.setattr(functional_mockup.shutil, "which", lambda name: None)
    with pytest.raises(go.GncOptError, match="install one"):
        export_fmu(follower(), tmp_path / "law.fmu", dt=DT, binary=True)
    assert export_fmu(follower(), tmp_path / "law.fmu", dt=DT).binary is None
    assert list(tmp_path.iterdir()) == [tmp_path / "law.fmu"]
