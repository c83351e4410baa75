"""Small faults in Python source: one token, one call or one statement is changed at a time.

A fault is a change of text at the position that `ast` reports, so that the rest of the module,
including line numbers, is unchanged. Code that tests should not fix is skipped: texts of messages,
annotations, decorators and imports, seeds, and numbers below 1e-9 that keep a divisor from 0.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

_COMPARE = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: (r"is\s+not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: (r"not\s+in", "in"),
}
_ARITHMETIC = {
    ast.Add: (r"\+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: (r"\*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "/"),
    ast.Mod: ("%", "//"),
    ast.Pow: (r"\*\*", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: (r"\|", "&"),
    ast.LShift: ("<<", ">>"),
    ast.RShift: (">>", "<<"),
}
_LOGIC = {ast.And: ("and", "or"), ast.Or: ("or", "and")}
_SIGNS = {ast.Not: "not", ast.USub: "-", ast.Invert: "~"}
# Names of functions, plain or after a dot, and their replacements.
_CALLS = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "fmin": "fmax",
    "fmax": "fmin",
    "argmin": "argmax",
    "argmax": "argmin",
    "any": "all",
    "all": "any",
    "floor": "ceil",
    "ceil": "floor",
    "sin": "cos",
    "cos": "sin",
    "median": "min",
    "abs": "",
}
_GUARD = 1e-9
_SKIPPED = (ast.Import, ast.ImportFrom, ast.JoinedStr)


@dataclass(frozen=True)
class Mutant:
    """A module with one fault.

    Parameters
    ----------
    function
        Qualified name of the enclosing function, ``<module>`` outside of functions.
    line
        Line number, counted from 1.
    before, after
        The changed line, without indentation.
    source
        The complete module with the fault.
    """

    function: str
    line: int
    before: str
    after: str
    source: str

    @property
    def key(self) -> tuple[str, str, str]:
        """Identification that does not depend on other lines of the module."""
        return self.function, self.before, self.after


def mutants_of(source: str) -> list[Mutant]:
    """Return all faults that the operators produce, in the order of the text."""
    return list(_Walk(source).mutants())


class _Walk:
    def __init__(self, source: str) -> None:
        # Columns of ast count bytes.
        self._text = source.encode()
        self._starts = [0]
        for line in self._text.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self._tree = ast.parse(source)

    def mutants(self) -> Iterator[Mutant]:
        found = {}
        for function, begin, end, text in self._changes(self._tree, "<module>"):
            changed = self._text[:begin] + text.encode() + self._text[end:]
            line = self._text.count(b"\n", 0, begin)
            found[begin, end, text] = Mutant(
                function,
                line + 1,
                self._text.splitlines()[line].decode().strip(),
                changed.splitlines()[line].decode().strip(),
                changed.decode(),
            )
        for place in sorted(found):
            yield found[place]

    def _changes(self, node: ast.AST, function: str) -> Iterator[tuple[str, int, int, str]]:
        if isinstance(node, _SKIPPED) or _is_type_checking(node):
            return
        for begin, end, text in self._of(node):
            yield function, begin, end, text
        if isinstance(node, ast.Raise) or _is_generator(node):
            return
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            function = node.name if function == "<module>" else f"{function}.{node.name}"
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from self._changes(child, function)

    def _of(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        match node:
            case ast.Compare():
                sides = [node.left, *node.comparators]
                for i, op in enumerate(node.ops):
                    yield self._between(sides[i], sides[i + 1], *_COMPARE[type(op)])
            case ast.BinOp() if type(node.op) in _ARITHMETIC:
                yield self._between(node.left, node.right, *_ARITHMETIC[type(node.op)])
            case ast.AugAssign():
                if type(node.op) in _ARITHMETIC:
                    pattern, other = _ARITHMETIC[type(node.op)]
                    yield self._between(node.target, node.value, f"{pattern}=", f"{other}=")
                yield (*self._span(node), "pass")
            case ast.BoolOp():
                for left, right in zip(node.values, node.values[1:], strict=False):
                    yield self._between(left, right, *_LOGIC[type(node.op)])
            case ast.UnaryOp() if type(node.op) in _SIGNS:
                begin, _ = self._span(node)
                yield begin, begin + len(_SIGNS[type(node.op)]), ""
            case ast.Constant(value=bool()):
                yield (*self._span(node), str(not node.value))
            case ast.Constant(value=int()):
                yield (*self._span(node), str(node.value + 1))
            case ast.Constant(value=float()) if not 0 < node.value < _GUARD:
                yield (*self._span(node), repr(2 * node.value if node.value else 1.0))
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in _CALLS:
                _, end = self._span(node.func)
                begin, _ = self._span(node.func)
                other = _CALLS[name]
                yield (end - len(name) if other else begin), end, other
            case ast.If() | ast.IfExp() if not isinstance(node.test, ast.UnaryOp):
                begin, end = self._span(node.test)
                yield begin, end, f"not ({self._text[begin:end].decode()})"
            case ast.Expr(value=ast.Call()) | ast.Raise():
                yield (*self._span(node), "pass")
            case ast.Return(value=ast.expr()) if not _is_none(node.value):
                yield (*self._span(node), "return None")
            case ast.Break():
                yield (*self._span(node), "continue")
            case ast.Continue():
                yield (*self._span(node), "break")

    def _span(self, node: ast.AST) -> tuple[int, int]:
        begin = self._starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        end = self._starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        return begin, end

    def _between(
        self, left: ast.AST, right: ast.AST, pattern: str, other: str
    ) -> tuple[int, int, str]:
        """Find the operator between two operands, where brackets and comments may also be."""
        begin, end = self._span(left)[1], self._span(right)[0]
        between = re.sub(rb"#[^\n]*", lambda m: b" " * len(m[0]), self._text[begin:end])
        found = re.search(pattern.encode(), between)
        if found is None:
            raise AssertionError(f"no {pattern} between two operands: {between!r}")
        return begin + found.start(), begin + found.end(), other


def _is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def _is_generator(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and ast.unparse(node.func) == "np.random.default_rng"


def _is_none(node: ast.AST | None) -> bool:
    return isinstance(node, ast.Constant) and node.value is None
