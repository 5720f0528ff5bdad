"""Rows that are used at once: gather, evaluate, whiten, and accumulate or weigh in one compiled loop.

Some rows at a time are evaluated in the lanes of vectors; row by row, while they are in the cache, their products are
then added to normal equations (SUMS), or multiplied by what comes of these (LEVERAGES). No derivative is ever stored.
Predictions alone (VALUES) are written where they belong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calib.compiled.intermediate import ATTRIBUTES, Instruction, Writer, needed
from calib.compiled.scalars import Scalars

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


SUMS, LEVERAGES, VALUES = "sums", "leverages", "values"
_ROWS = ("blocks", "bases", "indices")
_PLACES = (*_ROWS, "weights", "owner", "places", "inner", "coupling", "index", "totals")
POINTERS = {SUMS: (*_PLACES, "readings", "pull", "pulls", "objective"), LEVERAGES: (*_PLACES, "half", "found"),
            VALUES: (*_ROWS, "found")}


def fused(shape: Shape, task: str, lanes: int) -> str:
    """LLVM IR of `rows(count, far, wide, pointers...)` for blocks that are single rows.

    task: SUMS, LEVERAGES or VALUES; far, wide: distances of the rows of places and of coupling; pointers: POINTERS of
    the task in order, of which bases, indices, index, totals and pulls are arrays of pointers.
    """
    writer = Writer(lanes)
    lines = Scalars(writer)
    counts = {"bases": len(shape.feeds), "indices": len(shape.feeds), "index": len(shape.pairs),
              "totals": len(shape.pairs), "pulls": len(shape.outside)}
    fixed = {(name, k): lines.load(f"%{name}", k, kind="ptr")
             for name in POINTERS[task] for k in range(counts.get(name, 0))}
    first = len(writer.lines)
    _evaluate(writer, lines, shape, task, fixed)
    kept = shape.dim * (1 + sum(shape.freedoms))
    second = len(writer.lines)
    {SUMS: _products, LEVERAGES: _leverages, VALUES: _values}[task](lines, shape, lanes, fixed)
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


def _evaluate(writer: Writer, lines: Scalars, shape: Shape, task: str, fixed: dict[tuple[str, int], str]) -> None:
    """Whitened residuals (where wanted) and derivatives of a vector of rows, (1 + all columns) times dim vectors, into
    the scratch; or predictions as they are."""
    rows = []
    for lane in range(writer.lanes):  # behind the end the last row stands in
        place = lines.value(f"call i64 @llvm.smin.i64(i64 {lines.whole('add', '%row', lane)}, i64 %last)")
        rows.append(lines.load("%blocks", place, kind="i64"))

    def gathered(base: str, offsets: Sequence[str]) -> str:
        vector = "poison"
        for lane, offset in enumerate(offsets):
            number = lines.load(base, offset)
            vector = lines.value(f"insertelement {writer.type} {vector}, double {number}, i32 {lane}")
        return vector

    inputs: list[str] = []
    for k, (kind, width) in enumerate(shape.feeds):
        instances = [lines.load(fixed["indices", k], r, kind="i64") for r in rows] if kind == INDEXED else rows
        starts = ["0"] * writer.lanes if kind == SHARED else [lines.whole("mul", i, width) for i in instances]
        inputs += [gathered(fixed["bases", k], [lines.whole("add", s, j) for s in starts]) for j in range(width)]
    own = [lines.whole("mul", r, shape.dim) for r in rows]
    places = [[lines.whole("add", o, j) for o in own] for j in range(shape.dim)]
    weights = [] if task == VALUES else [gathered("%weights", p) for p in places]

    def keep(number: int, value: str) -> None:
        weighed = writer.operation("MUL", weights[number % shape.dim], value) if weights else value
        place = lines.at("%scratch", number * writer.lanes)
        writer.lines.append(f"  store {writer.type} {weighed}, ptr {place}, align {8 * writer.lanes}")

    def store(number: int, value: str) -> None:
        if number >= shape.dim or task == VALUES:
            keep(number, value)
            return
        residual = gathered("%readings", places[number])
        if not shape.given:
            residual = writer.operation("SUB", residual, value)
            if (period := shape.periods[number]) is not None:
                turns = writer.intrinsic("rint", writer.operation("DIV", residual, writer.constant(period)))
                residual = writer.operation("SUB", residual, writer.operation("MUL", writer.constant(period), turns))
        keep(number, residual)

    wanted = needed(shape.instructions, shape.dim) if task == LEVERAGES else shape.instructions
    writer.run(wanted, inputs.__getitem__, store)


def _row(lines: Scalars, shape: Shape, lanes: int) -> tuple[list[str], list[list[str]], list[list[list[str]]]]:
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


def _place(lines: Scalars, number: int) -> str:
    """Where the products of one outer column stand in a row of the coupling."""
    return lines.load("%places", "%far", number, "%one", kind="i32")


def _products(lines: Scalars, shape: Shape, lanes: int, fixed: dict[tuple[str, int], str]) -> None:
    """Add the products of one row to the normal equations."""
    residual, mine, outside = _row(lines, shape, lanes)
    lines.add(lines.dot(residual, residual), "%objective", 0)
    if mine:
        f, owner = len(mine), lines.load("%owner", "%one", kind="i64")
        for k in range(f):
            lines.add(lines.dot(mine[k], residual), "%pull", owner, f, k)
            for j in range(k + 1):
                lines.add(lines.dot(mine[k], mine[j]), "%inner", owner, f * f, k * f + j)
        for o, column in enumerate(c for one in outside for c in one):
            place = _place(lines, o)
            for k in range(f):
                lines.add(lines.dot(mine[k], column), "%coupling", "%wide", k, place)
    for p, (s, t) in enumerate(shape.pairs):
        index = lines.load(fixed["index", p], "%one", kind="i32")
        g, h = len(outside[s]), len(outside[t])
        for a in range(g):
            for b in range(a + 1 if s == t else h):
                lines.add(lines.dot(outside[s][a], outside[t][b]), fixed["totals", p], index, g * h, a * h + b)
            if s == t:
                lines.add(lines.dot(outside[s][a], residual), fixed["pulls", s], index, g, a)


def _leverages(lines: Scalars, shape: Shape, lanes: int, fixed: dict[tuple[str, int], str]) -> None:
    """The diagonal of J C J' of one row. C is half' inner half of an eliminated instance, -half' coupling of it with
    the outer columns, and totals of these."""
    _, mine, outside = _row(lines, shape, lanes)
    components = range(shape.dim)
    f, total, crossed = len(mine), ["0.0"] * shape.dim, list(mine)
    if mine:
        owner = lines.load("%owner", "%one", kind="i64")
        half, inner = ([[lines.load(base, owner, f * f, k * f + j) for j in range(f)] for k in range(f)]
                       for base in ("%half", "%inner"))
        through = [[lines.dot(row, [m[d] for m in mine]) for d in components] for row in half]
        crossed = [[lines.dot(row, [t[d] for t in through]) for d in components] for row in inner]
        for o, column in enumerate(c for one in outside for c in one):
            place = _place(lines, o)
            for k in range(f):
                met = lines.load("%coupling", "%wide", k, place)
                twice = lines.value(f"fmul double {met}, -2.0")
                crossed[k] = [lines.sum(crossed[k][d], twice, column[d]) for d in components]
        total = [lines.dot([t[d] for t in through], [c[d] for c in crossed]) for d in components]
    for p, (s, t) in enumerate(shape.pairs):
        index = lines.load(fixed["index", p], "%one", kind="i32")
        g, h = len(outside[s]), len(outside[t])
        for a in range(g):
            # of a symmetric block the part below the diagonal counts twice, and so does a block that stands there
            count = a + 1 if s == t else h
            number = [lines.load(fixed["totals", p], index, g * h, a * h + b) for b in range(count)]
            number = [n if s == t and b == a else lines.value(f"fmul double {n}, 2.0") for b, n in enumerate(number)]
            for d in components:
                row = lines.dot(number, [outside[t][b][d] for b in range(count)])
                total[d] = lines.sum(total[d], outside[s][a][d], row)
    _store(lines, shape, total)


def _values(lines: Scalars, shape: Shape, lanes: int, _fixed: dict[tuple[str, int], str]) -> None:
    """The predictions of one row."""
    _store(lines, shape, _row(lines, shape, lanes)[0])


def _store(lines: Scalars, shape: Shape, numbers: Sequence[str]) -> None:
    """Put the numbers of one row where they belong."""
    block = lines.load("%blocks", "%one", kind="i64")
    for d, number in enumerate(numbers):
        lines.store(number, "%found", block, shape.dim, d)
