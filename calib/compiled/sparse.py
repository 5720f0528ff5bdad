"""Compiled loops over many small blocks of which each meets few of the other columns (calib.coupling)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from calib.compiled.intermediate import Writer
from calib.compiled.scalars import Scalars

NUMBERS = ("begin", "end", "far", "others", "apart")
POINTERS = ("first", "columns", "values", "matrix", "symmetric", "out", "more", "room")
AT_ONCE = 4  # sums that run beside each other, so that none waits for the one before


class _Text(Scalars):
    """A function of loops over blocks and their entries."""

    def __init__(self) -> None:
        super().__init__(Writer(1))

    def column(self, entry: str) -> str:
        """The column of an entry."""
        return self.load("%columns", entry, kind="i32")

    def loop(self, name: str, begin: str, end: str, body: Callable[..., Sequence[str] | None], carried: int = 0
             ) -> list[str]:
        """A loop over whole numbers, which may be empty; some sums that begin at zero are carried through it."""
        sums, place = [f"%{name}_sum{k}" for k in range(carried)], len(self.lines)
        after = body(f"%{name}", *sums) or ()
        inside = self.lines[place:]
        self.lines[place:] = [
            f"  br label %{name}_start", f"{name}_start:", f"  br label %{name}_head", f"{name}_head:",
            f"  %{name} = phi i64 [ {begin}, %{name}_start ], [ %{name}_next, %{name}_last ]",
            *[f"  {s} = phi double [ 0.0, %{name}_start ], [ {a}, %{name}_last ]"
              for s, a in zip(sums, after, strict=True)],
            f"  %{name}_more = icmp slt i64 %{name}, {end}",
            f"  br i1 %{name}_more, label %{name}_body, label %{name}_done", f"{name}_body:", *inside,
            f"  br label %{name}_last", f"{name}_last:", f"  %{name}_next = add i64 %{name}, 1",
            f"  br label %{name}_head", f"{name}_done:"]
        return sums

    def function(self) -> str:
        """The function `rows` with these lines."""
        given = ", ".join([f"i64 %{a}" for a in NUMBERS] + [f"ptr %{a}" for a in POINTERS])
        return "\n".join([f"define void @rows({given}) #0 {{", "entry:", *self.lines, "  ret void", "}",
                          "declare i64 @llvm.smin.i64(i64, i64)", "attributes #0 = { nounwind }", ""])

    # --- blocks -------------------------------------------------------------------------------------------------------

    def entries(self, block: str) -> tuple[str, str]:
        """The first entry of a block, and the one behind its last."""
        after = self.value(f"add i64 {block}, 1")
        return self.load("%first", block, kind="i64"), self.load("%first", after, kind="i64")

    def matrix(self, block: str, freedom: int) -> list[list[str]]:
        """The rows of the matrix by which a block is multiplied."""
        return [[self.load("%matrix", block, str(freedom * freedom), str(k * freedom + j)) for j in range(freedom)]
                for k in range(freedom)]

    def mapped(self, rows: Sequence[Sequence[str]], entry: str) -> list[str]:
        """The numbers of an entry, multiplied by the matrix of their block."""
        values = [self.load("%values", "%far", str(j), entry) for j in range(len(rows))]
        return [self.dot(row, values) for row in rows]


def spread(freedom: int) -> str:
    """LLVM IR that puts blocks, each multiplied by its matrix, into a dense piece out (f, end - begin, S)."""
    text = _Text()

    def block(i: str) -> None:
        rows, line = text.matrix(i, freedom), text.value(f"mul i64 {text.value(f'sub i64 {i}, %begin')}, %others")

        def entry(e: str) -> None:
            place = text.value(f"add i64 {line}, {text.column(e)}")
            for k, number in enumerate(text.mapped(rows, e)):
                text.store(number, "%out", "%apart", str(k), place)
        text.loop("e", *text.entries(i), entry)
    text.loop("i", "%begin", "%end", block)
    return text.function()


def times(freedom: int) -> str:
    """LLVM IR that puts into out (m, f) the blocks times a vector, matrix (S,)."""
    text = _Text()

    def block(i: str) -> None:
        def entry(e: str, *sums: str) -> list[str]:
            right = text.load("%matrix", text.column(e))
            return [text.sum(s, text.load("%values", "%far", str(k), e), right) for k, s in enumerate(sums)]
        for k, total in enumerate(text.loop("e", *text.entries(i), entry, freedom)):
            text.store(total, "%out", i, str(freedom), str(k))
    text.loop("i", "%begin", "%end", block)
    return text.function()


def transposed(freedom: int) -> str:
    """LLVM IR that adds to out (S,) the transposed blocks times a vector, matrix (m, f)."""
    text = _Text()

    def block(i: str) -> None:
        left = [text.load("%matrix", i, str(freedom), str(k)) for k in range(freedom)]

        def entry(e: str) -> None:
            text.add(text.dot(left, [text.load("%values", "%far", str(k), e) for k in range(freedom)]), "%out",
                     text.column(e))
        text.loop("e", *text.entries(i), entry)
    text.loop("i", "%begin", "%end", block)
    return text.function()


def _kept(text: _Text, freedom: int, block: str) -> tuple[str, str]:
    """Put a block, multiplied by its matrix, into room (f, S); its first entry, and the one behind its last."""
    rows, (begin, end) = text.matrix(block, freedom), text.entries(block)

    def keep(e: str) -> None:
        for k, number in enumerate(text.mapped(rows, e)):
            text.store(number, "%room", "%others", k, text.whole("sub", e, begin))
    text.loop("e", begin, end, keep)
    return begin, end


def square(freedom: int) -> str:
    """LLVM IR that adds to out (S, S), on and below the diagonal, the square of the blocks, each multiplied by its
    matrix."""
    text = _Text()

    def block(i: str) -> None:
        begin, end = _kept(text, freedom, i)

        def row(a: str) -> None:
            mine = [text.load("%room", "%others", k, text.whole("sub", a, begin)) for k in range(freedom)]
            line = text.at("%out", text.column(a), "%others", 0)

            def column(b: str) -> None:
                theirs = [text.load("%room", "%others", k, text.whole("sub", b, begin)) for k in range(freedom)]
                text.add(text.dot(mine, theirs), line, text.column(b))
            text.loop("b", begin, text.whole("add", a, 1), column)
        text.loop("a", begin, end, row)
    text.loop("i", "%begin", "%end", block)
    return text.function()


def within(freedom: int) -> str:
    """LLVM IR that puts into out (f, nnz) the blocks, each multiplied by its matrix, times a symmetric (S, S), where
    blocks are; and into more (m, f, f) that times the transposed blocks."""
    text = _Text()

    def block(i: str) -> None:
        begin, end = _kept(text, freedom, i)
        last = text.whole("sub", end, 1)

        def some(n: str) -> None:  # behind the end the last entry is done again
            entry = text.whole("add", begin, text.whole("mul", n, AT_ONCE))
            these = [text.value(f"call i64 @llvm.smin.i64(i64 {text.whole('add', entry, k)}, i64 {last})")
                     for k in range(AT_ONCE)]
            lines = [text.at("%symmetric", text.column(b), "%others", 0) for b in these]

            def row(a: str, *sums: str) -> list[str]:
                mine = [text.load("%room", "%others", k, text.whole("sub", a, begin)) for k in range(freedom)]
                column = text.column(a)
                weights = [text.load(line, column) for line in lines]
                return [text.sum(s, weights[n // freedom], mine[n % freedom]) for n, s in enumerate(sums)]
            for n_sum, total in enumerate(text.loop("a", begin, end, row, AT_ONCE * freedom)):
                text.store(total, "%out", "%apart", n_sum % freedom, these[n_sum // freedom])

        def product(e: str, *sums: str) -> list[str]:
            mine = [text.load("%room", "%others", k, text.whole("sub", e, begin)) for k in range(freedom)]
            done = [text.load("%out", "%apart", k, e) for k in range(freedom)]
            return [text.sum(s, done[n // freedom], mine[n % freedom]) for n, s in enumerate(sums)]
        count = text.whole("sdiv", text.whole("add", text.whole("sub", end, begin), AT_ONCE - 1), AT_ONCE)
        text.loop("n", "0", count, some)
        for n, total in enumerate(text.loop("s", begin, end, product, freedom * freedom)):
            text.store(total, "%more", i, freedom * freedom, n)
    text.loop("i", "%begin", "%end", block)
    return text.function()
