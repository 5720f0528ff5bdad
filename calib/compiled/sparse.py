"""Compiled loops over many small blocks of which each meets few of the other columns (calib.coupling)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

NUMBERS = ("begin", "end", "far", "others", "apart")
POINTERS = ("first", "columns", "values", "matrix", "symmetric", "out", "more")


class _Text:
    """Lines of LLVM IR with names of their own."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._count = 0

    def value(self, text: str) -> str:
        """Name of the value of an expression."""
        self._count += 1
        self.lines.append(f"  %v{self._count} = {text}")
        return f"%v{self._count}"

    def at(self, base: str, *offset: str, kind: str = "double") -> str:
        """Address of the element at a product of two numbers and a third, or at one."""
        place = offset[0] if len(offset) == 1 else self.value(
            f"add i64 {self.value(f'mul i64 {offset[0]}, {offset[1]}')}, {offset[2]}")
        return self.value(f"getelementptr {kind}, ptr {base}, i64 {place}")

    def load(self, base: str, *offset: str, kind: str = "double") -> str:
        """The element there."""
        return self.value(f"load {kind}, ptr {self.at(base, *offset, kind=kind)}, align {4 if kind == 'i32' else 8}")

    def column(self, entry: str) -> str:
        """The column of an entry."""
        return self.value(f"zext i32 {self.load('%columns', entry, kind='i32')} to i64")

    def store(self, number: str, base: str, *offset: str) -> None:
        """Put a number there."""
        self.lines.append(f"  store double {number}, ptr {self.at(base, *offset)}, align 8")

    def add(self, number: str, base: str, *offset: str) -> None:
        """Add a number to the element there."""
        place = self.at(base, *offset)
        there = self.value(f"load double, ptr {place}, align 8")
        self.lines.append(f"  store double {self.value(f'fadd double {there}, {number}')}, ptr {place}, align 8")

    def sum(self, total: str, left: str, right: str) -> str:
        """A sum and a product more."""
        return self.value(f"fadd contract double {total}, {self.value(f'fmul contract double {left}, {right}')}")

    def dot(self, left: Sequence[str], right: Sequence[str]) -> str:
        """Sum of products."""
        total = self.value(f"fmul contract double {left[0]}, {right[0]}")
        for a, b in zip(left[1:], right[1:], strict=True):
            total = self.sum(total, a, b)
        return total

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
                          "attributes #0 = { nounwind }", ""])

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


def square(freedom: int) -> str:
    """LLVM IR that adds to out (S, S), on and below the diagonal, the square of the blocks, each multiplied by its
    matrix; more: room for one block (f, S)."""
    text = _Text()

    def block(i: str) -> None:
        rows, (begin, end) = text.matrix(i, freedom), text.entries(i)

        def keep(e: str) -> None:
            place = text.value(f"sub i64 {e}, {begin}")
            for k, number in enumerate(text.mapped(rows, e)):
                text.store(number, "%more", "%others", str(k), place)

        def row(a: str) -> None:
            mine = [text.load("%more", "%others", str(k), text.value(f"sub i64 {a}, {begin}")) for k in range(freedom)]
            line, after = text.at("%out", text.column(a), "%others", "0"), text.value(f"add i64 {a}, 1")

            def column(b: str) -> None:
                place = text.value(f"sub i64 {b}, {begin}")
                theirs = [text.load("%more", "%others", str(k), place) for k in range(freedom)]
                text.add(text.dot(mine, theirs), line, text.column(b))
            text.loop("b", begin, after, column)
        text.loop("e", begin, end, keep)
        text.loop("a", begin, end, row)
    text.loop("i", "%begin", "%end", block)
    return text.function()


def within(freedom: int) -> str:
    """LLVM IR that puts into out (f, nnz) the blocks, each multiplied by its matrix, times a symmetric (S, S), where
    blocks are; and adds to more (m, f, f) that times the transposed blocks."""
    text = _Text()

    def block(i: str) -> None:
        rows, (begin, end) = text.matrix(i, freedom), text.entries(i)

        def clear(e: str) -> None:
            for k in range(freedom):
                text.store("0.0", "%out", "%apart", str(k), e)

        def row(a: str) -> None:
            line, mine = text.at("%symmetric", text.column(a), "%others", "0"), text.mapped(rows, a)

            def column(b: str) -> None:  # no sum waits for the one before
                weight = text.load(line, text.column(b))
                for k, number in enumerate(mine):
                    place = text.at("%out", "%apart", str(k), b)
                    there = text.value(f"load double, ptr {place}, align 8")
                    text.lines.append(f"  store double {text.sum(there, weight, number)}, ptr {place}, align 8")
            text.loop("b", begin, end, column)

        def entry(e: str, *sums: str) -> list[str]:
            mine, done = text.mapped(rows, e), [text.load("%out", "%apart", str(k), e) for k in range(freedom)]
            return [text.sum(s, done[n // freedom], mine[n % freedom]) for n, s in enumerate(sums)]
        text.loop("e", begin, end, clear)
        text.loop("a", begin, end, row)
        for n, total in enumerate(text.loop("s", begin, end, entry, freedom * freedom)):
            text.store(total, "%more", i, str(freedom * freedom), str(n))
    text.loop("i", "%begin", "%end", block)
    return text.function()
