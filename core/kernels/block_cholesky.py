"""Cholesky's factor of a sparse symmetric matrix of 6 x 6 blocks, row by row along the elimination tree.

One index a block instead of one a number, and one half of the matrix: a third of what a general sparse solver keeps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop, sums

Array64 = NDArray[np.float64]
Rows = NDArray[np.int64]

SIDE = 6
"""Rows and columns of a block: the unknowns of a pose."""


class BlockFactor(NamedTuple):
    """A lower triangular matrix of blocks by columns, within a column from top to bottom.

    begins (n + 1,): where each column begins; rows (b,) int32 and blocks (b, 6, 6): of each block.
    """

    begins: Rows
    rows: NDArray[np.int32]
    blocks: Array64


def factorised(first: Rows, second: Rows, links: Array64, diagonal: Array64) -> BlockFactor:
    """The lower factor of the matrix with `diagonal` (n, 6, 6) and, for each of e pairs of different places, `links`
    (e, 6, 6) at row `first` and column `second` and its transpose at the other place; those of one pair add up.

    Raises RuntimeError where the matrix is not positive definite.
    """
    count = len(diagonal)
    below = np.maximum(first, second)
    order = np.argsort(below, kind="stable")
    starts = np.searchsorted(below[order], np.arange(count + 1))
    beside, turned = np.minimum(first, second)[order], (first > second)[order]
    parents, seen, sizes = np.full(count, -1), np.arange(count), np.ones(count, dtype=np.int64)
    _grow_tree(starts, beside, parents, seen, sizes)
    begins = np.concatenate([[0], np.cumsum(sizes)])
    factor = BlockFactor(begins, np.empty(begins[-1], np.int32), np.empty((begins[-1], SIDE, SIDE)))
    ends, chain, stack, work = (
        begins[:-1].copy(),
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.zeros_like(diagonal),
    )
    seen[:] = -1
    if not _factorise(starts, beside, turned, order, links, diagonal, parents, seen, chain, stack, work, ends, *factor):
        raise RuntimeError("the matrix is not positive definite")
    return factor


def solved(factor: BlockFactor, right: Array64) -> Array64:
    """What the matrix of a factor takes to `right` (n, 6, k): of the same shape."""
    found = np.array(right, order="C")
    _substitute(*factor, found)
    return found


@loop
def _grow_tree(starts: Rows, beside: Rows, parents: Rows, seen: Rows, sizes: Rows) -> None:
    """Fill in the `parents` (n,) of the elimination tree, and add to `sizes` (n,) the blocks below the diagonal."""
    for i in range(len(parents)):
        for link in range(starts[i], starts[i + 1]):
            k = beside[link]
            while seen[k] != i:
                if parents[k] < 0:
                    parents[k] = i
                sizes[k] += 1
                seen[k] = i
                k = parents[k]


@sums
def _factorise(
    starts: Rows, beside: Rows, turned: NDArray[np.bool_], order: Rows, links: Array64, diagonal: Array64,
    parents: Rows, seen: Rows, chain: Rows, stack: Rows, work: Array64, ends: Rows, begins: Rows,
    rows: NDArray[np.int32], blocks: Array64,
) -> bool:  # fmt: skip
    """Fill in `rows` and `blocks`, a row of the factor after the other; whether the matrix is positive definite.

    `work` (n, 6, 6) is zero, `ends` (n,) where the columns begin; `seen`, `chain` and `stack` (n,) are for use here.
    """
    count = len(parents)
    for i in range(count):
        seen[i] = i
        top = count
        for link in range(starts[i], starts[i + 1]):
            k, length, p = beside[link], 0, order[link]
            for a in range(SIDE):
                for b in range(SIDE):
                    work[k, a, b] += links[p, b, a] if turned[link] else links[p, a, b]
            while seen[k] != i:
                chain[length] = k
                length += 1
                seen[k] = i
                k = parents[k]
            while length > 0:
                length -= 1
                top -= 1
                stack[top] = chain[length]
        for a in range(SIDE):
            for b in range(SIDE):
                work[i, a, b] = diagonal[i, a, b]
        for place in range(top, count):
            k = stack[place]
            first, end = begins[k], ends[k]
            _divide(blocks, first, work, k)
            _take_off(blocks, rows, first + 1, end, work, k)
            _take_square_off(work, k, i)
            rows[end] = i
            ends[k] = end + 1
            for a in range(SIDE):
                for b in range(SIDE):
                    blocks[end, a, b] = work[k, b, a]
                    work[k, b, a] = 0.0
        rows[ends[i]] = i
        if not _take_root(work, i, blocks, ends[i]):
            return False
        ends[i] += 1
    return True


@sums
def _divide(blocks: Array64, of: int, work: Array64, k: int) -> None:
    """Divide work[k] from the left by the triangle blocks[of]."""
    for a in range(SIDE):
        inverse = 1.0 / blocks[of, a, a]
        for c in range(a):
            share = blocks[of, a, c]
            for b in range(SIDE):
                work[k, a, b] -= share * work[k, c, b]
        for b in range(SIDE):
            work[k, a, b] *= inverse


@sums
def _take_off(blocks: Array64, rows: NDArray[np.int32], first: int, end: int, work: Array64, k: int) -> None:
    """Take the products of blocks[first:end] with work[k] off the work of their rows."""
    for p in range(first, end):
        row = rows[p]
        for a in range(SIDE):
            for b in range(SIDE):
                left = work[row, a, b]
                for c in range(SIDE):
                    left -= blocks[p, a, c] * work[k, c, b]
                work[row, a, b] = left


@sums
def _take_square_off(work: Array64, k: int, i: int) -> None:
    """Take the square of work[k] off work[i]."""
    for c in range(SIDE):
        for a in range(SIDE):
            for b in range(SIDE):
                work[i, a, b] -= work[k, c, a] * work[k, c, b]


@sums
def _take_root(work: Array64, i: int, blocks: Array64, of: int) -> bool:
    """The triangle blocks[of] whose square is work[i], which becomes zero; whether there is one."""
    for a in range(SIDE):
        for b in range(SIDE):
            blocks[of, a, b] = 0.0
        for b in range(a + 1):
            left = work[i, a, b]
            for c in range(b):
                left -= blocks[of, a, c] * blocks[of, b, c]
            if a == b and not left > 0.0:
                return False
            blocks[of, a, b] = np.sqrt(left) if a == b else left / blocks[of, b, b]
    for a in range(SIDE):
        for b in range(SIDE):
            work[i, a, b] = 0.0
    return True


@sums
def _substitute(begins: Rows, rows: NDArray[np.int32], blocks: Array64, found: Array64) -> None:
    """Solve for `found` (n, 6, k) in place: forwards by the factor, backwards by its transpose."""
    count, width = len(begins) - 1, found.shape[2]
    for i in range(count):
        _divide_right(blocks, begins[i], found, i)
        for p in range(begins[i] + 1, begins[i + 1]):
            row = rows[p]
            for a in range(SIDE):
                for c in range(SIDE):
                    share = blocks[p, a, c]
                    for b in range(width):
                        found[row, a, b] -= share * found[i, c, b]
    for i in range(count - 1, -1, -1):
        for p in range(begins[i] + 1, begins[i + 1]):
            row = rows[p]
            for c in range(SIDE):
                for a in range(SIDE):
                    share = blocks[p, a, c]
                    for b in range(width):
                        found[i, c, b] -= share * found[row, a, b]
        _divide_back(blocks, begins[i], found, i)


@sums
def _divide_right(blocks: Array64, of: int, found: Array64, i: int) -> None:
    """Divide found[i] (6, k) by the triangle blocks[of]."""
    for a in range(SIDE):
        for b in range(found.shape[2]):
            left = found[i, a, b]
            for c in range(a):
                left -= blocks[of, a, c] * found[i, c, b]
            found[i, a, b] = left / blocks[of, a, a]


@sums
def _divide_back(blocks: Array64, of: int, found: Array64, i: int) -> None:
    """Divide found[i] (6, k) by the transpose of the triangle blocks[of]."""
    for a in range(SIDE - 1, -1, -1):
        for b in range(found.shape[2]):
            left = found[i, a, b]
            for c in range(a + 1, SIDE):
                left -= blocks[of, c, a] * found[i, c, b]
            found[i, a, b] = left / blocks[of, a, a]


def inverse_diagonal(factor: BlockFactor) -> Array64:
    """The blocks (n, 6, 6) on the diagonal of the inverse of the matrix of a factor, which is used up by it.

    Of the inverse only what has a place in the factor is made, from the last column to the first (Takahashi's
    equations): all that a column needs lies in the columns of its rows.
    """
    longest = int(np.diff(factor.begins).max(initial=1))
    _invert_selected(*factor, np.zeros((SIDE, SIDE)), *np.zeros((2, longest, SIDE, SIDE)))
    return np.array(factor.blocks[factor.begins[:-1]])


@sums
def _invert_selected(
    begins: Rows, rows: NDArray[np.int32], blocks: Array64, triangle: Array64, gains: Array64, summed: Array64
) -> None:
    """Replace the `blocks` of a factor by those of the inverse; the rest is for use here."""
    for j in range(len(begins) - 2, -1, -1):
        first, below = begins[j], begins[j + 1] - begins[j] - 1
        _invert_triangle(blocks, first, triangle)
        for q in range(below):
            _multiply(blocks, first + 1 + q, triangle, gains, summed, q)
        for q in range(below):
            k = rows[first + 1 + q]
            p = begins[k]
            _add_product(summed, q, blocks, p, gains, q)
            for r in range(q + 1, below):
                while rows[p] != rows[first + 1 + r]:
                    p += 1
                _add_product(summed, r, blocks, p, gains, q)
                _add_turned(summed, q, blocks, p, gains, r)
        for a in range(SIDE):
            for b in range(SIDE):
                blocks[first, a, b] = 0.0
                for c in range(SIDE):
                    blocks[first, a, b] += triangle[c, a] * triangle[c, b]
        for q in range(below):
            _add_turned(blocks, first, gains, q, summed, q)
            for a in range(SIDE):
                for b in range(SIDE):
                    blocks[first + 1 + q, a, b] = -summed[q, a, b]


@sums
def _invert_triangle(blocks: Array64, of: int, triangle: Array64) -> None:
    """Fill `triangle` (6, 6) with the inverse of the lower triangle blocks[of]."""
    for b in range(SIDE):
        for a in range(SIDE):
            left = 1.0 if a == b else 0.0
            for c in range(b, a):
                left -= blocks[of, a, c] * triangle[c, b]
            triangle[a, b] = left / blocks[of, a, a] if a >= b else 0.0


@sums
def _multiply(blocks: Array64, of: int, triangle: Array64, gains: Array64, summed: Array64, q: int) -> None:
    """gains[q] = blocks[of] triangle; summed[q] = 0."""
    for a in range(SIDE):
        for b in range(SIDE):
            total = 0.0
            for c in range(SIDE):
                total += blocks[of, a, c] * triangle[c, b]
            gains[q, a, b] = total
            summed[q, a, b] = 0.0


@sums
def _add_product(to: Array64, at: int, left: Array64, i: int, right: Array64, j: int) -> None:
    """to[at] += left[i] right[j]."""
    for a in range(SIDE):
        for b in range(SIDE):
            total = to[at, a, b]
            for c in range(SIDE):
                total += left[i, a, c] * right[j, c, b]
            to[at, a, b] = total


@sums
def _add_turned(to: Array64, at: int, left: Array64, i: int, right: Array64, j: int) -> None:
    """to[at] += left[i]^T right[j]."""
    for a in range(SIDE):
        for b in range(SIDE):
            total = to[at, a, b]
            for c in range(SIDE):
                total += left[i, c, a] * right[j, c, b]
            to[at, a, b] = total
