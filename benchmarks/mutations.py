"""Small changes of Python code, as slips of a programmer's hand: what `mutate.py` tries."""

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

TURNED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
NAMES = {"min": "max", "minimum": "maximum", "argmin": "argmax", "any": "all", "cos": "sin"}
NAMES |= {"floor": "ceil", "zeros": "ones", "median": "max", "sum": "max", "intersection": "union"}
NAMES |= {theirs: ours for ours, theirs in NAMES.items() if theirs not in NAMES}
COMMUTE = ("hypot", "logaddexp", "max", "maximum", "min", "minimum", "multiply")


@dataclass(frozen=True)
class Mutation:
    """One change: the text from `start` to `end` (bytes of the file) becomes `after`.

    function: qualified name of the function it is in, "" = none. first: its first line, or that
    of the change.
    """

    path: str
    line: int
    function: str
    first: int
    kind: str
    start: int
    end: int
    before: str
    after: str

    @property
    def package(self) -> str:
        """The package of the program."""
        return self.path.split("/")[1]

    @property
    def name(self) -> str:
        """What tells it from all others, as long as the lines above it stay."""
        return f"{self.path}:{self.line}:{self.start}:{self.kind}:{self.before}:{self.after}"

    def apply(self, content: bytes) -> bytes:
        """Return the content of the file with the change."""
        assert content[self.start : self.end].decode() == self.before
        return content[: self.start] + self.after.encode() + content[self.end :]

    def describe(self) -> str:
        """Return it in a line."""
        before, after = (" ".join(text.split()) for text in (self.before, self.after))
        where = f"{self.path}:{self.line} {self.function}"
        return f"{where}: {self.kind}: `{before}` -> `{after}`"


def find_mutations(root: Path, path: Path) -> list[Mutation]:
    """Return all mutations of a file, in the order of its lines."""
    content = (root / path).read_bytes()
    lines = content.splitlines(keepends=True)
    starts = [sum(map(len, lines[:k])) for k in range(len(lines))]
    found = []
    for node, function, first in _nodes(ast.parse(content), "", 0):
        for kind, after in _changes(node):
            start = starts[node.lineno - 1] + node.col_offset
            end = starts[node.end_lineno - 1] + node.end_col_offset
            before = content[start:end].decode()
            line = node.lineno
            where = (path.as_posix(), line, function, first or line)
            found.append(Mutation(*where, kind, start, end, before, after))
    return sorted(found, key=lambda mutation: (mutation.start, mutation.end, mutation.kind))


def _nodes(node: ast.AST, function: str, first: int) -> Iterator[tuple[ast.AST, str, int]]:
    """Walk through code that computes: no annotations, decorators, texts or imports.

    Yields each node with the name of its function, and the first line of that.
    """
    skipped = ("annotation", "returns", "decorator_list", "type_params", "msg")
    for name, value in ast.iter_fields(node):
        if name in skipped or isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST):
                continue
            if hasattr(child, "lineno"):
                yield child, function, first
            inside, start = function, first
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                parent = f"{function}." if function else ""
                if parent and isinstance(node, ast.FunctionDef):
                    parent = f"{function}.<locals>."
                inside, start = f"{parent}{child.name}", child.body[0].lineno
            yield from _nodes(child, inside, start)


def _changes(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Return the kinds of mutations of a node, and what it becomes."""
    change = CHANGES.get(type(node))
    if change:
        yield from change(node)


def _with(node: ast.AST, **changes: object) -> str:
    """Return the code of a node with other fields, in brackets."""
    changed = copy.copy(node)
    for name, value in changes.items():
        setattr(changed, name, value)
    code = ast.unparse(changed)
    return f"({code})" if isinstance(node, ast.expr) else code


def _of_comparison(node: ast.Compare) -> Iterator[tuple[str, str]]:
    turned = TURNED[type(node.ops[0])]()
    yield "comparison turned", _with(node, ops=[turned, *node.ops[1:]])


def _of_operation(node: ast.BinOp) -> Iterator[tuple[str, str]]:
    is_text = any(isinstance(side, ast.JoinedStr) for side in (node.left, node.right))
    is_type = isinstance(node.op, ast.BitOr) and "None" in ast.unparse(node)
    if type(node.op) in OPERATORS and not is_text and not is_type:
        yield "operator changed", _with(node, op=OPERATORS[type(node.op)]())
    if isinstance(node.op, ast.Mult):
        yield "factor dropped", f"({ast.unparse(node.right)})"
    if isinstance(node.op, ast.Add) and not is_text:
        yield "term dropped", f"({ast.unparse(node.left)})"
    if isinstance(node.op, ast.MatMult | ast.Sub | ast.Div):
        yield "operands exchanged", _with(node, left=node.right, right=node.left)


def _of_sign(node: ast.UnaryOp) -> Iterator[tuple[str, str]]:
    if isinstance(node.op, ast.Not | ast.Invert | ast.USub):
        yield "sign dropped", f"({ast.unparse(node.operand)})"


def _of_condition(node: ast.BoolOp) -> Iterator[tuple[str, str]]:
    other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    yield "and for or", _with(node, op=other)


def _of_constant(node: ast.Constant) -> Iterator[tuple[str, str]]:
    value = node.value
    if isinstance(value, bool):
        yield "constant changed", repr(not value)
    elif isinstance(value, int):
        yield "constant changed", f"({value + 1})"
    elif isinstance(value, float):
        yield "constant changed", f"({2 * value if value else 1.0!r})"


def _of_choice(node: ast.IfExp) -> Iterator[tuple[str, str]]:
    yield "condition negated", _with(node, body=node.orelse, orelse=node.body)


def _of_call(node: ast.Call) -> Iterator[tuple[str, str]]:
    first = node.args[:2]
    commutes = ast.unparse(node.func).split(".")[-1] in COMMUTE
    if len(first) == 2 and not commutes and not any(isinstance(a, ast.Starred) for a in first):
        yield "arguments exchanged", _with(node, args=[first[1], first[0], *node.args[2:]])
    if isinstance(node.func, ast.Attribute) and node.func.attr in NAMES:
        other = copy.copy(node.func)
        other.attr = NAMES[node.func.attr]
        yield "function changed", _with(node, func=other)


def _of_statement(node: ast.Expr | ast.AugAssign | ast.Assign) -> Iterator[tuple[str, str]]:
    if isinstance(node, ast.Expr) and not isinstance(node.value, ast.Call):
        return  # a docstring, or a yield
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
        return  # a name that is missing later would be noticed always
    yield "line left out", "pass"


def _of_loop_end(_node: ast.Break | ast.Continue) -> Iterator[tuple[str, str]]:
    yield "line left out", "pass"


CHANGES: dict[type[ast.AST], Callable] = {
    ast.Compare: _of_comparison,
    ast.BinOp: _of_operation,
    ast.UnaryOp: _of_sign,
    ast.BoolOp: _of_condition,
    ast.Constant: _of_constant,
    ast.IfExp: _of_choice,
    ast.Call: _of_call,
    ast.Expr: _of_statement,
    ast.AugAssign: _of_statement,
    ast.Assign: _of_statement,
    ast.Break: _of_loop_end,
    ast.Continue: _of_loop_end,
}
