"""Conversion of CasADi expressions to MathML, for the problem statement of a report.

A subexpression that is repeated or long becomes an auxiliary quantity with its own formula.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any

import casadi as ca

from gnc_opt.text_html_and_json_formatting import GREEK_NAMES, split_symbol_and_index

FORMULA_MAX_NODES = 400
"""Largest number of operations and symbols in the formulas of a phase; larger ones are described by their arguments."""

AUXILIARY_MIN_NODES = 6
"""Smallest repeated subexpression that gets its own formula."""

AUXILIARY_LONG_NODES = 26
"""Size from which a subexpression gets its own formula, which limits the line length."""

_GREEK = dict(zip(GREEK_NAMES, "αβγδεζηθικλμνξπρστφχψωΓΔΘΛΞΠΣΦΨΩ", strict=True))

_CONDITIONAL, _SUM, _SIGNED, _PRODUCT, _ATOM = range(5)
"""Operator precedence: an operand of lower precedence than its operation is put in parentheses."""

_TIMES = '<mo>&#8290;</mo><mspace width="0.15em"/>'

_MINUS = "<mo form='prefix'>−</mo>"

_PRODUCTS = {ca.OP_MUL: 1.0, ca.OP_NEG: -1.0, ca.OP_TWICE: 2.0, ca.OP_SQ: 1.0}
"""Operations of a product with their constant factor."""

_FUNCTIONS = {
    ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan", ca.OP_ASIN: "arcsin", ca.OP_ACOS: "arccos",
    ca.OP_ATAN: "arctan", ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh", ca.OP_ASINH: "arsinh",
    ca.OP_ACOSH: "arcosh", ca.OP_ATANH: "artanh", ca.OP_EXP: "exp", ca.OP_LOG: "ln", ca.OP_LOG1P: "ln1p",
    ca.OP_EXPM1: "expm1", ca.OP_ERF: "erf", ca.OP_SIGN: "sign", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil",
    ca.OP_ATAN2: "atan2", ca.OP_FMIN: "min", ca.OP_FMAX: "max", ca.OP_FMOD: "mod", ca.OP_HYPOT: "hypot",
    ca.OP_COPYSIGN: "copysign", ca.OP_REMAINDER: "remainder",
}  # fmt: skip

_LATEX_FUNCTION = r"(\\(?:arc(?:sin|cos|tan)|(?:sin|cos|tan)h?|exp|ln|log)(?![a-z]))"

_BEFORE_SIGN = r"(<mo[^>]*>(?!&#x000(?:29|5D|7D|7C);|&#x02016;|[)\]}|!])[^<]*</mo>)"
"""An operator other than a closing fence, after which a minus is a sign."""

_RELATIONS = {ca.OP_LT: "&lt;", ca.OP_LE: "≤", ca.OP_EQ: "=", ca.OP_NE: "≠", ca.OP_AND: "∧", ca.OP_OR: "∨"}


@dataclass
class Formulas:
    """Writer of scalar expressions, which collects their auxiliary quantities."""

    names: dict[int, str]
    auxiliary: list[tuple[str, str]] = field(default_factory=list)
    shown: int = 0
    letter: str = field(init=False)
    _repeated: set[int] = field(default_factory=set)
    _sizes: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        used = "".join(self.names.values())
        self.letter = next(letter for letter in "kwcabdegηζ" if f"<mi>{letter}</mi>" not in used)

    def are_formulas_short(self, expressions: Any) -> bool:
        """Return whether a column of expressions is short enough to be written; records repeated subexpressions."""
        uses: Counter[int] = Counter()
        waiting = ca.vertsplit(ca.densify(expressions))
        while waiting:
            node = waiting.pop()
            for operand in self._list_expression_operands(node):
                place = operand.element_hash()
                uses[place] += 1
                if uses[place] == 1:
                    waiting.append(operand)
            if len(uses) > FORMULA_MAX_NODES:
                return False
        self._repeated |= {place for place, count in uses.items() if count > 1}
        return True

    def split_formula_terms(self, expression: Any) -> list[str]:
        """Return the signed terms of a formula, between which a line may break."""
        return list(self._iterate_terms_of_sum(expression, ""))

    def _list_expression_operands(self, node: Any) -> list[Any]:
        named = node.element_hash() in self.names
        return [] if named else [node.dep(i) for i in range(node.n_dep())]

    def _iterate_terms_of_sum(self, node: Any, sign: str, least: int = _CONDITIONAL) -> Iterator[str]:
        if (
            node.element_hash() not in self.names
            and node.n_dep() == 2
            and node.op() in (ca.OP_ADD, ca.OP_SUB)
        ):
            yield from self._iterate_terms_of_sum(node.dep(0), sign, _SUM)
            if node.op() == ca.OP_ADD:
                yield from self._iterate_terms_of_sum(node.dep(1), "+", _SUM)
                return
            yield _typeset_binary_operator("−") + self._operand_to_mathml(node.dep(1), _PRODUCT)
            return
        text, binding = self._expression_to_mathml(node)
        if sign and binding == _SIGNED:
            yield _typeset_binary_operator("−") + text.removeprefix(_MINUS)
        else:
            text = text if binding >= least else _enclose_mathml_in_parentheses(text)
            yield (_typeset_binary_operator(sign) if sign else "") + text

    def _count_subexpressions(self, node: Any) -> int:
        place = node.element_hash()
        if place not in self._sizes:
            self._sizes[place] = 1 + sum(
                self._count_subexpressions(operand) for operand in self._list_expression_operands(node)
            )
        return self._sizes[place]

    def _needs_auxiliary_variable(self, node: Any) -> bool:
        size, repeated = self._count_subexpressions(node), node.element_hash() in self._repeated
        return size >= AUXILIARY_LONG_NODES or (repeated and size >= AUXILIARY_MIN_NODES)

    def _operand_to_mathml(self, node: Any, least: int) -> str:
        """Return an operand, in parentheses if its precedence is below ``least``."""
        text, binding = self._expression_to_mathml(node)
        place = node.element_hash()
        if self._needs_auxiliary_variable(node) and place not in self.names:
            known = {formula: name for name, formula in self.auxiliary}
            if text not in known:
                known[text] = f"<msub><mi>{self.letter}</mi><mn>{len(self.auxiliary) + 1}</mn></msub>"
                self.auxiliary.append((known[text], text))
            self.names[place], binding = known[text], _ATOM
            text = known[text]
            self._sizes.clear()
        return text if binding >= least else _enclose_mathml_in_parentheses(text)

    def _expression_to_mathml(self, node: Any) -> tuple[str, int]:
        place = node.element_hash()
        if place in self.names:
            return self.names[place], _ATOM
        if node.is_constant():
            value = float(node)
            return typeset_number(value), _ATOM if value >= 0 else _SIGNED
        if node.is_symbolic():
            return typeset_variable_name(node.name()), _ATOM
        if node.op() in _PRODUCTS:
            return self._product_to_mathml(node)
        return self._operation_to_mathml(node.op(), [node.dep(i) for i in range(node.n_dep())])

    def _product_to_mathml(self, node: Any) -> tuple[str, int]:
        """Return a product: number, auxiliary quantities, named symbols in the order of the names, other factors."""
        number, waiting, powers = 1.0, [node], Counter[int]()
        texts: dict[int, str] = {}
        while waiting:
            factor = waiting.pop()
            place = factor.element_hash()
            operands = [factor.dep(i) for i in range(factor.n_dep())]
            if place not in self.names and factor.is_constant():
                number *= float(factor)
            elif (
                place not in self.names
                and factor.op() in _PRODUCTS
                and self._is_factor_written_in_place(factor, node)
            ):
                number *= _PRODUCTS[factor.op()]
                waiting += operands[::-1] * (2 if factor.op() == ca.OP_SQ else 1)
            else:
                powers[place] += 1
                texts[place] = texts.get(place) or self._operand_to_mathml(factor, _ATOM)
        of_auxiliary = dict(self.auxiliary)
        ranks = {
            place: -1 if name in of_auxiliary else i for i, (place, name) in enumerate(self.names.items())
        }
        shown = [typeset_number(abs(number))] * (abs(number) != 1.0 or not powers)
        for place in sorted(powers, key=lambda p: ranks.get(p, len(ranks))):
            power = powers[place]
            shown.append(_typeset_power(texts[place], f"<mn>{power}</mn>") if power > 1 else texts[place])
        binding = _SIGNED if number < 0 else _PRODUCT if len(shown) > 1 else _ATOM
        return _MINUS * (number < 0) + _TIMES.join(shown), binding

    def _is_factor_written_in_place(self, factor: Any, product: Any) -> bool:
        """Return whether a factor becomes no auxiliary quantity, after its own operands have become some."""
        if factor is not product and self._needs_auxiliary_variable(factor):
            self._expression_to_mathml(factor)
        return factor is product or not self._needs_auxiliary_variable(factor)

    def _operation_to_mathml(self, op: int, parts: list[Any]) -> tuple[str, int]:
        write = self._operand_to_mathml
        if op in (ca.OP_ADD, ca.OP_SUB):
            first, sign = write(parts[0], _SUM), "+" if op == ca.OP_ADD else "−"
            second = write(parts[1], _SUM if op == ca.OP_ADD else _PRODUCT)
            if op == ca.OP_ADD and second.startswith(_MINUS):
                sign, second = "−", second.removeprefix(_MINUS)
            return first + _typeset_binary_operator(sign) + second, _SUM
        if op in (ca.OP_DIV, ca.OP_INV):
            above = "<mn>1</mn>" if op == ca.OP_INV else write(parts[0], _SUM)
            below = write(parts[-1], _SUM)
            return f"<mfrac><mrow>{above}</mrow><mrow>{below}</mrow></mfrac>", _ATOM
        if op in (ca.OP_POW, ca.OP_CONSTPOW):
            return _typeset_power(write(parts[0], _ATOM), write(parts[1], _SUM)), _ATOM
        if op == ca.OP_SQRT:
            return f"<msqrt>{write(parts[0], _SUM)}</msqrt>", _ATOM
        if op == ca.OP_FABS:
            return f"<mo>|</mo>{write(parts[0], _SUM)}<mo>|</mo>", _ATOM
        if op in _RELATIONS:
            left, right = (write(part, _SUM) for part in parts)
            return f"{left}<mo>{_RELATIONS[op]}</mo>{right}", _CONDITIONAL
        if op == ca.OP_IF_ELSE_ZERO:
            value, condition = write(parts[1], _PRODUCT), write(parts[0], _CONDITIONAL)
            return f"{value}<mtext> if </mtext>{condition}", _CONDITIONAL
        if op == ca.OP_NOT:
            return f"<mo>¬</mo>{write(parts[0], _ATOM)}", _ATOM
        name = _FUNCTIONS.get(op, f"operation {op}")
        return typeset_function_call(name, [write(part, _SUM) for part in parts]), _ATOM


def convert_latex_to_mathml(formula: str, display: str) -> str:
    """Return MathML of LaTeX: spaces around functions, none after signs, fences that fit. Needs latex2mathml."""
    from latex2mathml.converter import convert

    spaced = re.sub(r"(?<=[\w})])(?<!\\cdot)(?<!\\times)\s*" + _LATEX_FUNCTION, r"\\,\1", formula)
    power = r"(?:\^(?:\{[^{}]*\}|\\?\w))?"
    spaced = re.sub(_LATEX_FUNCTION[:-1] + power + r")\s*(?![\s({[^]|\\left|\\[bB]ig)", r"\1\\,", spaced)
    sized = re.sub(r"\\[bB]igg?[lr]?(?=[(\[])", r"\\left", spaced)
    sized = re.sub(r"\\[bB]igg?[lr]?(?=[)\]])", r"\\right", sized)
    mathml = str(convert(sized, display=display)).replace("<mo>&#x02202;</mo>", "<mi>&#x02202;</mi>")
    mathml = re.sub(r'<mo( stretchy="false")?>(?=&#x000(?:2F|7C);)', r'<mo\1 lspace="0" rspace="0">', mathml)
    mathml = re.sub(r"<mo>([A-Za-z]\w+)</mo>", r"<mi>\1</mi>", mathml)  # names of operators are upright
    return re.sub(_BEFORE_SIGN + "<mo>&#x02212;</mo>", r'\1<mo form="prefix">&#x02212;</mo>', mathml)


def typeset_function_call(name: str, arguments: Iterable[str]) -> str:
    return f"<mi>{escape(name)}</mi>{_enclose_mathml_in_parentheses('<mo>,</mo>'.join(arguments))}"


def typeset_component_names(symbols: Mapping[str, Any]) -> dict[int, str]:
    """Return MathML by ``element_hash`` for the components of symbols, given by their names."""
    found = {}
    for name, symbol in symbols.items():
        elements = ca.vertsplit(symbol)
        for i, element in enumerate(elements):
            label = name if len(elements) == 1 else f"{name}[{i}]"
            found[element.element_hash()] = typeset_variable_name(label)
    return found


def typeset_variable_name(label: str, *, dotted: bool = False) -> str:
    """Return a name such as ``r_L[0]`` or ``omega`` as MathML, components counted from 1; dotted: its derivative."""
    base, marks = split_symbol_and_index(label)
    text = f"<mi>{escape(_GREEK.get(base, base))}</mi>"
    if dotted:
        text = f"<mover accent='true'>{text}<mo>˙</mo></mover>"
    return f"<msub>{text}<mtext>{escape(marks)}</mtext></msub>" if marks else text


def typeset_names_in_html(html: str, names: Iterable[str]) -> str:
    """Return HTML with names of variables outside of tags typeset as in formulas: "b.sigma[0]" is "b σ" with index 1.

    Names of one letter without an index may be words: only those that begin a row of a table are typeset. Exponents are
    raised, and negative numbers have a minus sign.
    """
    known = "|".join(sorted((re.escape(name) for name in names), key=len, reverse=True))
    label = re.compile(rf"(?<![\w.])(?:{known})(?:\[\d+\])?(?![\w\[])")

    def typeset_matched_variable_name(found: re.Match[str]) -> str:
        base, marks = split_symbol_and_index(found[0])
        owner, _, base = base.rpartition(".")
        symbol = _GREEK.get(base, base)
        symbol = f"<i>{symbol}</i>" if len(symbol) == 1 and symbol != found[0] else symbol
        return f"{owner} {symbol}".lstrip() + f"<sub>{marks}</sub>" * bool(marks)

    parts = re.split(r"(?s)(<code>.*?</code>|<pre>.*?</pre>|<[^>]*>)", html)
    parts[::2] = [
        re.sub(r"(?<![\w.^])-(?=\d)", "−", re.sub(r"(?<=\d)e([+-]\d+)\b", _typeset_power_of_ten, part))
        for part in parts[::2]
    ]
    parts = re.split(r"(<[^>]*>)", "".join(parts))
    texts = (
        part if part.startswith("<") or not known else label.sub(typeset_matched_variable_name, part)
        for part in parts
    )
    text = (
        re.sub(r"(?<=<tr><td>)([A-Za-z])(?=</td>| [≥≤[])", r"<i>\1</i>", "".join(texts))
        if known
        else "".join(texts)
    )
    return re.sub(r"(?<=[A-Za-z])\^(-?\d+(?:\.\d+)?)", r"<sup>\1</sup>", text)


def _typeset_power_of_ten(found: re.Match[str]) -> str:
    """Return "·10⁻⁵" of "e-05", whose exponent is the first group."""
    return "·10" + str(int(found[1])).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def typeset_number(value: float) -> str:
    """Return a number with six digits and a typeset exponent."""
    digits, _, exponent = f"{abs(value):.6g}".partition("e")
    text = f"<mn>{digits}</mn>"
    if exponent:
        power = f"<msup><mn>10</mn><mrow>{_typeset_signed_number(int(exponent))}</mrow></msup>"
        text = power if digits == "1" else f"{text}<mo>·</mo>{power}"
    return (_MINUS if value < 0 else "") + text


def format_inline_formula(content: str) -> str:
    return f"<math>{content}</math>"


def _typeset_signed_number(value: int) -> str:
    return f"{_MINUS}<mn>{-value}</mn>" if value < 0 else f"<mn>{value}</mn>"


def _typeset_binary_operator(sign: str) -> str:
    return f"<mo form='infix'>{sign}</mo>"


def _typeset_power(base: str, power: str) -> str:
    base = _enclose_mathml_in_parentheses(base) if base.startswith(("<mfrac", "<msup")) else base
    return f"<msup><mrow>{base}</mrow><mrow>{power}</mrow></msup>"


def _enclose_mathml_in_parentheses(text: str) -> str:
    return f"<mrow><mo>(</mo>{text}<mo>)</mo></mrow>"
