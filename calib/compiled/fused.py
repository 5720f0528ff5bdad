"""Rows whose derivatives are used at once: gather, evaluate, whiten, and accumulate or weigh in one compiled loop.

Some rows at a time are evaluated in the lanes of vectors; row by row, while they are in the cache, their products are
then added to normal equations (SUMS), or multiplied by what comes of these (LEVERAGES). No derivative is ever stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calib.compiled.intermediate import ATTRIBUTES, Instruction, Writer, needed

SHARED, INDEXED, OWN = "shared", "indexed", "own"  # an input is one number, that of an instance, or that of the row


@dataclass(frozen=True)
class Shape:
    """What a fused loop is written for.

    instructions: of the prediction and its derivatives; feeds: (kind, width) of the arguments in order; dim: readings
    of a row; periods: of each, or None; given: whether residuals are given instead of readings; freedoms: columns of
    each argument with derivatives; inside, outside: which of these are eliminated, and which are not; pairs: places in
    outside of the pairs of products.
    """

    instructions: tuple[Instruction, ...]
    feeds: tuple[tuple[str, int], ...]
    dim: int
    periods: tuple[float | None, ...]
    given: bool
    freedoms: tuple[int, ...]
    inside: tuple[int, ...]
    outside: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]


SUMS, LEVERAGES = "sums", "leverages"
_ALWAYS = ("blocks", "bases", "indices", "weights", "owner", "places", "inner", "coupling", "index", "totals")
POINTERS = {SUMS: (*_ALWAYS, "readings", "pull", "pulls", "objective"), LEVERAGES: (*_ALWAYS, "half", "leverage")}


class _Lines:
    """Scalar code after the vectors of a row."""

    def __init__(self, writer: Writer):
        self.value, self.lines = writer.value, writer.lines

    def at(self, base: str, offset: str | int, kind: str = "double") -> str:
        """Address of an element."""
        return self.value(f"getelementptr {kind}, ptr {base}, i64 {offset}")

    def load(self, base: str, offset: str | int, kind: str = "double") -> str:
        """An element."""
        return self.value(f"load {kind}, ptr {self.at(base, offset, kind)}, align {4 if kind == 'i32' else 8}")

    def whole(self, operation: str, a: str | int, b: str | int) -> str:
        """Sum or product of whole numbers."""
        return self.value(f"{operation} i64 {a}, {b}")

    def sum(self, total: str, left: str, right: str) -> str:
        """A sum and a product more."""
        return self.value(f"fadd contract double {total}, {self.value(f'fmul contract double {left}, {right}')}")

    def dot(self, left: Sequence[str], right: Sequence[str]) -> str:
        """Sum of products."""
        total = self.value(f"fmul contract double {left[0]}, {right[0]}")
        for a, b in zip(left[1:], right[1:], strict=True):
            total = self.sum(total, a, b)
        return total

    def add(self, base: str, offset: str | int, number: str) -> None:
        """Add a number to an element in memory."""
        place = self.at(base, offset)
        there = self.value(f"load double, ptr {place}, align 8")
        self.lines.append(f"  store double {self.value(f'fadd double {there}, {number}')}, ptr {place}, align 8")


def fused(shape: Shape, task: str, lanes: int) -> str:
    """LLVM IR of `rows(count, far, wide, pointers...)` for blocks that are single rows.

    task: SUMS or LEVERAGES; far, wide: distances of the rows of places and of coupling; pointers in the order of
    POINTERS of the task, of which bases, indices, index, totals and pulls are arrays of pointers.
    """
    writer = Writer(lanes)
    lines = _Lines(writer)
    counts = {"bases": len(shape.feeds), "indices": len(shape.feeds), "index": len(shape.pairs),
              "totals": len(shape.pairs), **({"pulls": len(shape.outside)} if task == SUMS else {})}
    fixed = {(name, k): lines.load(f"%{name}", k, "ptr") for name, many in counts.items() for k in range(many)}
    first = len(writer.lines)
    _evaluate(writer, lines, shape, task, fixed)
    kept = shape.dim * (1 + sum(shape.freedoms))
    second = len(writer.lines)
    (_products if task == SUMS else _leverages)(lines, shape, lanes, fixed)
    return "\n".join([
        f"define void @rows(i64 %count, i64 %far, i64 %wide, {', '.join(f'ptr %{p}' for p in POINTERS[task])}) #0 {{",
        "entry:", f"  %scratch = alloca [{kept * lanes} x double], align {8 * lanes}", *writer.lines[:first],
        "  %last = sub i64 %count, 1", "  br label %head",
        "head:", "  %row = phi i64 [ 0, %entry ], [ %next, %after ]",
        "  %more = icmp slt i64 %row, %count", "  br i1 %more, label %body, label %done",
        "body:", *writer.lines[first:second], f"  %next = add i64 %row, {lanes}",
        "  %rest = call i64 @llvm.smin.i64(i64 %next, i64 %count)",
        "  br label %lanes", "lanes:", "  %one = phi i64 [ %row, %body ], [ %onward, %lanes ]",
        *writer.lines[second:], "  %onward = add i64 %one, 1", "  %again = icmp slt i64 %onward, %rest",
        "  br i1 %again, label %lanes, label %after", "after:", "  br label %head",
        "done:", "  ret void", "}", "declare i64 @llvm.smin.i64(i64, i64)", *sorted(writer.declared.values()),
        ATTRIBUTES, "",
    ])


def _evaluate(writer: Writer, lines: _Lines, shape: Shape, task: str, fixed: dict[tuple[str, int], str]) -> None:
    """Whitened residuals (where wanted) and derivatives of a vector of rows, (1 + all columns) times dim vectors, into
    the scratch."""
    rows = []
    for lane in range(writer.lanes):  # behind the end the last row stands in
        place = lines.value(f"call i64 @llvm.smin.i64(i64 {lines.whole('add', '%row', lane)}, i64 %last)")
        rows.append(lines.load("%blocks", place, "i64"))

    def gathered(base: str, offsets: Sequence[str]) -> str:
        vector = "poison"
        for lane, offset in enumerate(offsets):
            number = lines.load(base, offset)
            vector = lines.value(f"insertelement {writer.type} {vector}, double {number}, i32 {lane}")
        return vector

    inputs: list[str] = []
    for k, (kind, width) in enumerate(shape.feeds):
        instances = [lines.load(fixed["indices", k], r, "i64") for r in rows] if kind == INDEXED else rows
        starts = ["0"] * writer.lanes if kind == SHARED else [lines.whole("mul", i, width) for i in instances]
        inputs += [gathered(fixed["bases", k], [lines.whole("add", s, j) for s in starts]) for j in range(width)]
    own = [lines.whole("mul", r, shape.dim) for r in rows]
    places = [[lines.whole("add", o, j) for o in own] for j in range(shape.dim)]
    weights = [gathered("%weights", p) for p in places]

    def keep(number: int, value: str) -> None:
        weighed = writer.operation("MUL", weights[number % shape.dim], value)
        place = lines.at("%scratch", number * writer.lanes)
        writer.lines.append(f"  store {writer.type} {weighed}, ptr {place}, align {8 * writer.lanes}")

    def store(number: int, value: str) -> None:
        if number >= shape.dim:
            keep(number, value)
            return
        residual = gathered("%readings", places[number])
        if not shape.given:
            residual = writer.operation("SUB", residual, value)
            if (period := shape.periods[number]) is not None:
                turns = writer.intrinsic("rint", writer.operation("DIV", residual, writer.constant(period)))
                residual = writer.operation("SUB", residual, writer.operation("MUL", writer.constant(period), turns))
        keep(number, residual)

    wanted = shape.instructions if task == SUMS else needed(shape.instructions, shape.dim)
    writer.run(wanted, inputs.__getitem__, store)


def _row(lines: _Lines, shape: Shape, lanes: int) -> tuple[list[str], list[list[str]], list[list[list[str]]]]:
    """Of one row the whitened residual (dim), and the derivatives (f, dim) of what is eliminated, with (O, f, dim) of
    what is not."""
    lane = lines.whole("sub", "%one", "%row")
    numbers = [lines.load("%scratch", lines.whole("add", lane, k * lanes))
               for k in range(shape.dim * (1 + sum(shape.freedoms)))]
    columns, begin = [], shape.dim
    for freedom in shape.freedoms:
        columns.append([numbers[begin + c * shape.dim : begin + (c + 1) * shape.dim] for c in range(freedom)])
        begin += freedom * shape.dim
    mine = columns[shape.inside[0]] if shape.inside else []
    for a in shape.inside[1:]:
        mine = [[lines.value(f"fadd double {x}, {y}") for x, y in zip(old, new, strict=True)]
                for old, new in zip(mine, columns[a], strict=True)]
    return numbers[: shape.dim], mine, [columns[a] for a in shape.outside]


def _place(lines: _Lines, number: int) -> str:
    """Where the products of one outer column stand in a row of the coupling."""
    place = lines.load("%places", lines.whole("add", lines.whole("mul", "%far", number), "%one"), "i32")
    return lines.value(f"zext i32 {place} to i64")


def _products(lines: _Lines, shape: Shape, lanes: int, fixed: dict[tuple[str, int], str]) -> None:
    """Add the products of one row to the normal equations."""
    residual, mine, outside = _row(lines, shape, lanes)
    lines.add("%objective", 0, lines.dot(residual, residual))
    if mine:
        f, owner = len(mine), lines.load("%owner", "%one", "i64")
        square, single = lines.whole("mul", owner, f * f), lines.whole("mul", owner, f)
        for k in range(f):
            lines.add("%pull", lines.whole("add", single, k), lines.dot(mine[k], residual))
            for j in range(k + 1):
                lines.add("%inner", lines.whole("add", square, k * f + j), lines.dot(mine[k], mine[j]))
        for o, column in enumerate(c for one in outside for c in one):
            place = _place(lines, o)
            for k in range(f):
                lines.add("%coupling", lines.whole("add", lines.whole("mul", "%wide", k), place),
                          lines.dot(mine[k], column))
    for p, (s, t) in enumerate(shape.pairs):
        index = lines.value(f"zext i32 {lines.load(fixed['index', p], '%one', 'i32')} to i64")
        g, h = len(outside[s]), len(outside[t])
        base, alone = lines.whole("mul", index, g * h), lines.whole("mul", index, g)
        for a in range(g):
            for b in range(a + 1 if s == t else h):
                lines.add(fixed["totals", p], lines.whole("add", base, a * h + b),
                          lines.dot(outside[s][a], outside[t][b]))
            if s == t:
                lines.add(fixed["pulls", s], lines.whole("add", alone, a), lines.dot(outside[s][a], residual))


def _leverages(lines: _Lines, shape: Shape, lanes: int, fixed: dict[tuple[str, int], str]) -> None:
    """The diagonal of J C J' of one row. C is half' inner half of an eliminated instance, -half' coupling of it with
    the outer columns, and totals of these."""
    _, mine, outside = _row(lines, shape, lanes)
    components = range(shape.dim)
    f, total, crossed = len(mine), ["0.0"] * shape.dim, list(mine)
    if mine:
        owner = lines.whole("mul", lines.load("%owner", "%one", "i64"), f * f)
        half, inner = ([[lines.load(base, lines.whole("add", owner, k * f + j)) for j in range(f)] for k in range(f)]
                       for base in ("%half", "%inner"))
        through = [[lines.dot(row, [m[d] for m in mine]) for d in components] for row in half]
        crossed = [[lines.dot(row, [t[d] for t in through]) for d in components] for row in inner]
        for o, column in enumerate(c for one in outside for c in one):
            place = _place(lines, o)
            for k in range(f):
                met = lines.load("%coupling", lines.whole("add", lines.whole("mul", "%wide", k), place))
                twice = lines.value(f"fmul double {met}, -2.0")
                crossed[k] = [lines.sum(crossed[k][d], twice, column[d]) for d in components]
        total = [lines.dot([t[d] for t in through], [c[d] for c in crossed]) for d in components]
    for p, (s, t) in enumerate(shape.pairs):
        index = lines.value(f"zext i32 {lines.load(fixed['index', p], '%one', 'i32')} to i64")
        g, h = len(outside[s]), len(outside[t])
        base = lines.whole("mul", index, g * h)
        for a in range(g):
            # of a symmetric block the part below the diagonal counts twice, and so does a block that stands there
            count = a + 1 if s == t else h
            number = [lines.load(fixed["totals", p], lines.whole("add", base, a * h + b)) for b in range(count)]
            number = [n if s == t and b == a else lines.value(f"fmul double {n}, 2.0") for b, n in enumerate(number)]
            for d in components:
                row = lines.dot(number, [outside[t][b][d] for b in range(count)])
                total[d] = lines.sum(total[d], outside[s][a][d], row)
    block = lines.whole("mul", lines.load("%blocks", "%one", "i64"), shape.dim)
    for d in components:
        place = lines.at("%leverage", lines.whole("add", block, d))
        lines.lines.append(f"  store double {total[d]}, ptr {place}, align 8")
