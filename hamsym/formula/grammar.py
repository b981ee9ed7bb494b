"""Conversion of text to Python's syntax tree, with error messages for writers of formulas.

:mod:`hamsym.formula.parser` reads the tree; it is never compiled.
"""

from __future__ import annotations

import ast
import re
import unicodedata
import warnings

from hamsym.errors import ParseError

# Greek capitals and omicron that look like Latin letters are not accepted as names.
GREEK = "".join(sorted(set("ΓΔΘΛΞΠΣΦΨΩαβγδεζηθικλμνξπρςστυφχψω")))
# Variants that Python itself folds into the letter opposite.
_GREEK_VARIANTS = str.maketrans("ϕϑϵϱϖϰµΩ∆", "φθερπκμΩΔ")

_CHARACTER_REMEDIES = {
    "−": "write - for minus",
    "–": "write - for minus",
    "—": "write - for minus",
    "·": "write * for products",
    "×": "write * for products",
    "⋅": "write * for products",
    "∗": "write * for products",
    "÷": "write / for quotients",
    "∕": "write / for quotients",
    "√": "write sqrt(...)",
    "²": "write **2",
    "³": "write **3",
    "⁴": "write **4",
    "½": "write 1/2",
    "#": "leave comments out",
}

# `lambda` is a name in physics and a keyword in Python: it is parsed under a name of the same
# length that no accepted text can contain.
LAMBDA, LAMBDA_STAND_IN = "lambda", "łambda"

#: What to do with formulas that take too much.
SPLIT = "split it, or build a sympy expression"

# Problem and remedy of each construct that is valid in Python and not in a formula.
REFUSED_NODES: dict[type[ast.AST], tuple[str, str]] = {
    ast.Attribute: ("is attribute access", "use plain names such as p_x"),
    ast.Subscript: ("is a subscript", "write q1 instead of q[1]"),
    ast.Compare: ("is a comparison", "a Hamiltonian is one expression without relations"),
    ast.BoolOp: ("is a logical operation", "a Hamiltonian is one arithmetic expression"),
    ast.IfExp: ("is a conditional", "use min, max, abs or sign"),
    ast.Lambda: ("is a lambda", "write the expression alone"),
    ast.Tuple: ("is a list of expressions", "write one expression, with . for decimals"),
    ast.List: ("is a list", "group with parentheses ( )"),
    ast.Set: ("is a set", "group with parentheses ( )"),
    ast.Dict: ("is a dictionary", "group with parentheses ( )"),
    ast.JoinedStr: ("is a string", "write the formula without quotation marks"),
    ast.Starred: ("is unpacking", "write ** for powers and * between factors"),
    ast.NamedExpr: ("is an assignment", "give only the right-hand side"),
}
REFUSED_OPERATORS: dict[type[ast.AST], tuple[str, str, str]] = {
    ast.BitXor: ("^", "is not a power", "write ** for powers"),
    ast.FloorDiv: ("//", "is integer division", "write / for quotients"),
    ast.Mod: ("%", "is a remainder", "use only + - * / **"),
    ast.MatMult: ("@", "is a matrix product", "write * for products"),
    ast.LShift: ("<<", "is a bit shift", "use only + - * / **"),
    ast.RShift: (">>", "is a bit shift", "use only + - * / **"),
    ast.BitOr: ("|", "is a bit operation", "write abs(x) for |x|"),
    ast.BitAnd: ("&", "is a bit operation", "use only + - * / **"),
    ast.Invert: ("~", "is a bit operation", "write - for minus"),
    ast.Not: ("not", "is a logical operation", "write - for minus"),
}


def readable(text: str) -> str:
    """Return the text in the alphabet of formulas, character for character.

    Raise ParseError for the first character that is not allowed.
    """
    text = re.sub(r"[\t\r\n]", " ", text).translate(_GREEK_VARIANTS)
    for column, character in enumerate(text, 1):
        plain = " " <= character <= "~" and character != "#"
        if not plain and character not in GREEK:
            name = unicodedata.name(character, f"U+{ord(character):04X}").lower()
            raise ParseError(
                character if character.isprintable() else f"U+{ord(character):04X}",
                column,
                f"({name}) is not a character of formulas",
                _CHARACTER_REMEDIES.get(character, "use Latin or Greek letters and + - * / **"),
            )
    if not text.strip():
        raise ParseError("", 1, "is empty", "write a formula, for example p**2/2 + x**2/2")
    return re.sub(rf"\b{LAMBDA}\b", LAMBDA_STAND_IN, text)


def beginning(text: str, problem: str, remedy: str, start: int = 0) -> ParseError:
    """The error about a whole formula, which names its first characters."""
    return ParseError(
        text[start : start + 12] + "...", start + 1, f"begins a formula {problem}", remedy
    )


def syntax_tree(text: str) -> ast.Expression:
    """Parse a text from :func:`readable`, with columns counted in the whole text.

    Raise ParseError if the text is not an expression.
    """
    start = len(text) - len(text.lstrip())
    # Blanks before the first token would be an indentation error.
    padded = text.strip()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # for example for "x is 1", an error below
            tree = ast.parse(padded, mode="eval")
    except SyntaxError as error:
        raise _syntax_error(text, error, start) from None
    except (RecursionError, MemoryError, ValueError):
        raise beginning(text, "that is nested too deeply or too long", SPLIT, start) from None
    for node in ast.walk(tree):
        if isinstance(node, (ast.expr, ast.keyword)):
            node.col_offset += start
            node.end_col_offset = (node.end_col_offset or 0) + start
    return tree


def _syntax_error(text: str, error: SyntaxError, start: int) -> ParseError:
    """Translate an error of Python's parser into the terms of formulas."""
    shown = text.replace(LAMBDA_STAND_IN, LAMBDA)
    end = len(shown.rstrip())
    column = start + (error.offset or 0)
    if error.msg.startswith("Exceeds the limit"):
        match = re.search(r"\d{4300,}", shown)
        column = match.start() + 1 if match else 1
        return ParseError(shown[column - 1 :], column, "is too large a number", "stay below 1e308")
    if "never closed" in error.msg:
        bracket = shown[column - 1]
        missing = {"(": ")", "[": "]", "{": "}"}.get(bracket, ")")
        return ParseError(bracket, column, "is never closed", f"add the missing {missing}")
    if "too many nested" in error.msg:
        return ParseError("(", column, "is nested too deeply", "split the formula")
    if "unmatched" in error.msg or "does not match" in error.msg:
        return ParseError(shown[column - 1], column, "was never opened", "remove it or add a (")
    if column <= start or column > end:
        last = re.search(r"[^\W\d]\w*$|\S$", shown[:end])
        token = last.group() if last else shown.strip()
        stray = re.search(r"(?<![=<>!])=(?!=)", shown)
        if stray:
            return _equation_error(stray.start() + 1)
        return ParseError(
            token, end - len(token) + 1, "ends the formula too early", "complete or remove it"
        )
    if "=" in shown[column - 1 : column + 1] or ("=" in shown and "assign" in error.msg):
        return _equation_error(shown.find("=") + 1)
    match = re.compile(r"[^\W\d]\w*|\d[\w.]*|\S").match(shown, column - 1)
    token = match.group() if match else shown[column - 1 : column]
    before = shown[: column - 1].rstrip()
    if re.fullmatch(r"\d[\w.]*", token) and not token.replace(".", "").isdigit():
        return ParseError(token, column, "is not a number", "write * between number and name")
    if before and re.search(r"[\w)]$", before) and re.match(r"[\w(]", token):
        return ParseError(token, column, "follows without an operator", "write * for products")
    return ParseError(token, column, "is not valid here", "use numbers, names and + - * / **")


def _equation_error(column: int) -> ParseError:
    return ParseError(
        "=", column, "is an equation sign", "give a formula, the right-hand side of an equation"
    )
