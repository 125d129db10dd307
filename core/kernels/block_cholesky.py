"""Cholesky's factor of a sparse symmetric matrix of 6 x 6 blocks, in groups of columns that have the same rows below.

One list of rows a group instead of an index a number, and one half of the matrix: a third of what a general sparse
solver keeps. The numbers of a group are a dense panel, row after row, so that nearly all work is products of rows.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inner, inner_sums, loop, sums

Array64 = NDArray[np.float64]
Rows = NDArray[np.int64]

SIDE = 6
"""Rows and columns of a block: the unknowns of a pose."""

WIDEST = 8
"""Columns of blocks in a group, at most: its rows stay near the processor while they are multiplied."""


class Structure(NamedTuple):
    """Where the lower factor of a symmetric matrix has numbers, by groups of columns: the same for all such matrices.

    groups (g + 1,): the first column of each group; group_of (n,): of each column; rows (r,) int32: those below the
    columns of group k are rows[begins[k] : begins[k + 1]], from top to bottom. Its panel begins at offsets[k] and has
    the square of the group on top of these rows, across[k] numbers each. places (e + n,): where the first number of
    each of the e blocks belongs that are given beside the diagonal, then of those on it; widths (e + n,): from one row
    there to the next; turned (e + n,): whether a block is given transposed.
    """

    groups: Rows
    group_of: Rows
    begins: Rows
    rows: NDArray[np.int32]
    offsets: Rows
    across: Rows
    places: Rows
    widths: Rows
    turned: NDArray[np.bool_]

    @classmethod
    def of(cls, first: Rows, second: Rows, count: int) -> Structure:
        """Of `count` rows of blocks, with blocks at rows `first` (e,) and columns `second` (e,) beside the diagonal."""
        below, beside, columns = np.maximum(first, second), np.minimum(first, second), np.arange(count)
        order = np.argsort(below, kind="stable")
        links = np.searchsorted(below[order], np.arange(count + 1)), beside[order]
        parents, sizes = np.full(count, -1), np.zeros(count, dtype=np.int64)
        _walk(*links, parents, columns.copy(), sizes, np.empty(0, np.int32))
        rows = np.empty(sizes.sum(), np.int32)
        _walk(*links, parents, columns.copy(), np.cumsum(sizes) - sizes, rows)
        is_first = _group_starts(parents, sizes)
        is_last = np.append(is_first[1:], True)
        groups, group_of, deep = np.append(np.flatnonzero(is_first), count), np.cumsum(is_first) - 1, sizes[is_last]
        rows, begins, across = rows[np.repeat(is_last, sizes)], np.append(0, np.cumsum(deep)), SIDE * np.diff(groups)
        offsets = np.append(0, np.cumsum(across * (across + SIDE * deep)))
        row, column = np.append(below, columns), np.append(beside, columns)
        group = group_of[column]
        known = np.repeat(np.arange(len(deep)) * count, deep) + rows  # sorted: by group, then from top to bottom
        under = across[group] + SIDE * (np.searchsorted(known, group * count + row) - begins[group])
        at = np.where(group_of[row] == group, SIDE * (row - groups[group]), under)
        places = offsets[group] + at * across[group] + SIDE * (column - groups[group])
        turned = np.append(first < second, np.zeros(count, dtype=bool))
        return cls(groups, group_of, begins, rows, offsets, across, places, across[group], turned)


class BlockFactor(NamedTuple):
    """A lower triangular matrix of blocks: its structure, and the `numbers` of all panels, row by row."""

    structure: Structure
    numbers: Array64


def factorised(structure: Structure, links: Array64, diagonal: Array64) -> BlockFactor:
    """The lower factor of the matrix with `diagonal` (n, 6, 6) and, for each of e pairs of different places that the
    structure is of, `links` (e, 6, 6) at the one and its transpose at the other place; those of one pair add up.

    Raises RuntimeError where the matrix is not positive definite.
    """
    factor = BlockFactor(structure, np.zeros(structure.offsets[-1]))
    _add_blocks(links, 0, *factor)
    _add_blocks(diagonal, len(links), *factor)
    heads, following = np.full((2, len(structure.begins)), -1)
    if not _factorise(*factor, structure.begins.copy(), heads, following, np.empty(len(diagonal), np.int64)):
        raise RuntimeError("the matrix is not positive definite")
    return factor


def path(structure: Structure, columns: Iterable[int]) -> Rows:
    """The groups (p,) of some columns and of all that hang on these, in the order of elimination.

    The half of a solution whose right side has numbers in these columns alone has numbers in these groups alone.
    """
    found: set[int] = set()
    for column in columns:
        group = int(structure.group_of[column])
        while group not in found:
            found.add(group)
            if structure.begins[group] < structure.begins[group + 1]:
                group = int(structure.group_of[structure.rows[structure.begins[group]]])
    return np.array(sorted(found), dtype=np.int64)


def columns_of(structure: Structure, groups: Rows) -> Rows:
    """The columns (c,) of some groups, in their order."""
    parts = [np.arange(structure.groups[group], structure.groups[group + 1]) for group in groups]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)


def halve(factor: BlockFactor, right: Array64, groups: Rows | None = None) -> None:
    """Replace `right` (k, 6 n) by the first half of its solution, by the factor alone. `complete` is the other one.

    Where only some `groups` have numbers the others are left alone.
    """
    _forwards(*factor, np.arange(len(factor.structure.across)) if groups is None else groups, right)


def complete(factor: BlockFactor, half: Array64) -> None:
    """Replace the half (k, 6 n) of a solution by the solution."""
    _backwards(*factor, half)


def solved(factor: BlockFactor, right: Array64) -> Array64:
    """The solution of the factorised system for `right` (n, 6, k): of the same shape."""
    found = np.array(right.reshape(SIDE * len(right), -1).T, order="C")
    halve(factor, found)
    complete(factor, found)
    return found.T.reshape(right.shape)


def inverse_blocks(factor: BlockFactor, links: int = 0) -> tuple[Array64, Array64]:
    """Blocks of the inverse of the matrix of a factor, which is used up by it: (links, 6, 6), at the rows and columns
    of the first `links` pairs that its structure is of, and (n, 6, 6), on the diagonal.

    Of the inverse only blocks with a place in the factor are made, from the last group to the first (Takahashi's
    equations): all that a group needs lies in the groups of its rows.
    """
    structure, count = factor.structure, len(factor.structure.group_of)
    longest = SIDE * (WIDEST + int(np.diff(structure.begins).max(initial=0)))
    gains, summed = np.empty((WIDEST * SIDE, longest)), np.empty((WIDEST * SIDE, longest))
    _invert_selected(*factor, gains, summed, np.empty(SIDE * longest))
    beside = _blocks(factor, slice(links))
    turned = structure.turned[:links]
    beside[turned] = beside[turned].transpose(0, 2, 1)
    return beside, _blocks(factor, slice(len(structure.places) - count, None))


def _blocks(factor: BlockFactor, which: slice) -> Array64:
    """The blocks (b, 6, 6) at some of the places of a structure, as they lie there."""
    places, widths = factor.structure.places[which, None, None], factor.structure.widths[which, None, None]
    return np.asarray(factor.numbers[places + np.arange(SIDE)[:, None] * widths + np.arange(SIDE)])


def _group_starts(parents: Rows, sizes: Rows) -> NDArray[np.bool_]:
    """Which columns (n,) begin a group; `sizes` (n,) are their blocks below the diagonal."""
    columns = np.arange(len(parents))
    alike = (parents[:-1] == columns[1:]) & (sizes[1:] == sizes[:-1] - 1)
    since = columns - np.maximum.accumulate(np.where(np.append(True, ~alike), columns, 0))
    return np.asarray(since % WIDEST == 0)


@loop
def _walk(starts: Rows, beside: Rows, parents: Rows, seen: Rows, ends: Rows, rows: NDArray[np.int32]) -> None:
    """Go through the blocks of the factor below the diagonal, row by row: fill in the `parents` (n,) of the elimination
    tree, write rows from the `ends` (n,) of the columns on where there is room for `rows`, and move these ends.

    `seen` (n,) begins as the columns themselves.
    """
    for i in range(len(parents)):
        for link in range(starts[i], starts[i + 1]):
            k = beside[link]
            while seen[k] != i:
                if parents[k] < 0:
                    parents[k] = i
                if len(rows) > 0:
                    rows[ends[k]] = i
                ends[k] += 1
                seen[k] = i
                k = parents[k]


@loop
def _add_blocks(blocks: Array64, before: int, structure: Structure, numbers: Array64) -> None:
    """Add `blocks` (b, 6, 6) to the numbers at their places, those of the structure from `before` on."""
    for p in range(len(blocks)):
        place, width, turned = structure.places[before + p], structure.widths[before + p], structure.turned[before + p]
        for a in range(SIDE):
            for b in range(SIDE):
                numbers[place + a * width + b] += blocks[p, b, a] if turned else blocks[p, a, b]


@inner_sums
def _products(rows: Array64, i: int, one: Array64, count: int) -> tuple[float, float, float, float, float, float]:
    """The products of six rows, from the i-th on, with another `one` (c,): of their first `count` numbers."""
    p, q, r, s, t, u = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(count):
        share = one[c]
        p += rows[i, c] * share
        q += rows[i + 1, c] * share
        r += rows[i + 2, c] * share
        s += rows[i + 3, c] * share
        t += rows[i + 4, c] * share
        u += rows[i + 5, c] * share
    return p, q, r, s, t, u


@sums
def _factorise(structure: Structure, numbers: Array64, reached: Rows, heads: Rows, following: Rows, at: Rows) -> bool:
    """Turn the numbers into those of the factor, group by group; whether the matrix is positive definite.

    A group that is done waits in a list for the one that its next row below belongs to: the lists begin in `heads`
    (g + 1,) and go on in `following` (g + 1,), both -1 before; `reached` (g + 1,) are the next rows, the first ones
    before. `at` (n,) is for use here.
    """
    groups, _, begins, rows, offsets, across, _, _, _ = structure
    for g in range(len(across)):
        first, behind, panel = groups[g], groups[g + 1], numbers[offsets[g] : offsets[g + 1]].reshape(-1, across[g])
        for row in range(first, behind):
            at[row] = SIDE * (row - first)
        for p in range(begins[g], begins[g + 1]):
            at[rows[p]] = across[g] + SIDE * (p - begins[g])
        other = heads[g]
        while other >= 0:
            after, low, high = following[other], reached[other], reached[other]
            while high < begins[other + 1] and rows[high] < behind:
                high += 1
            left = rows[low : begins[other + 1]]
            source = numbers[offsets[other] : offsets[other + 1]].reshape(-1, across[other])
            _take_off(source[len(source) - SIDE * len(left) :], left, high - low, panel, first, at)
            reached[other] = high
            _wait(structure, other, reached, heads, following)
            other = after
        if not _take_root(panel):
            return False
        _wait(structure, g, reached, heads, following)
    return True


@inner
def _wait(structure: Structure, g: int, reached: Rows, heads: Rows, following: Rows) -> None:
    """Let a group wait for the one that its next row belongs to, if any is left."""
    if reached[g] < structure.begins[g + 1]:
        other = structure.group_of[structure.rows[reached[g]]]
        following[g], heads[other] = heads[other], g


@inner_sums
def _take_off(source: Array64, rows: NDArray[np.int32], near: int, panel: Array64, first: int, at: Rows) -> None:
    """Take the products of the blocks of `source`, of these `rows`, with the first `near` of them off a panel whose
    columns begin at `first`, and whose rows are `at` (n,): three rows with three, read once for nine products.
    """
    for i in range(0, len(source), 3):
        row = at[rows[i // SIDE]] + i % SIDE
        for j in range(0, SIDE * min(near, i // SIDE + 1), 3):
            column = SIDE * (rows[j // SIDE] - first) + j % SIDE
            ax, ay, az, bx, by, bz, cx, cy, cz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(source.shape[1]):
                a, b, c = source[i, k], source[i + 1, k], source[i + 2, k]
                x, y, z = source[j, k], source[j + 1, k], source[j + 2, k]
                ax += a * x
                ay += a * y
                az += a * z
                bx += b * x
                by += b * y
                bz += b * z
                cx += c * x
                cy += c * y
                cz += c * z
            panel[row, column] -= ax
            panel[row, column + 1] -= ay
            panel[row, column + 2] -= az
            panel[row + 1, column] -= bx
            panel[row + 1, column + 1] -= by
            panel[row + 1, column + 2] -= bz
            panel[row + 2, column] -= cx
            panel[row + 2, column + 1] -= cy
            panel[row + 2, column + 2] -= cz


@inner_sums
def _take_root(panel: Array64) -> bool:
    """Turn the square of a panel into its triangular root and divide the rows below by that; whether there is one."""
    for j in range(panel.shape[1]):
        for i in range(SIDE * (j // SIDE), len(panel), SIDE):
            products = _products(panel, i, panel[j], j)
            for a in range(SIDE):
                panel[i + a, j] -= products[a]
        if not panel[j, j] > 0.0:
            return False
        inverse = 1.0 / np.sqrt(panel[j, j])
        for i in range(j, len(panel)):
            panel[i, j] *= inverse
        for i in range(j):
            panel[i, j] = 0.0
    return True


@sums
def _forwards(structure: Structure, numbers: Array64, chosen: Rows, found: Array64) -> None:
    """Solve the rows of `found` (k, 6 n) in place by the factor, through the `chosen` groups (p,)."""
    groups, _, begins, rows, offsets, across, _, _, _ = structure
    for p in range(len(chosen)):
        g = chosen[p]
        panel = numbers[offsets[g] : offsets[g + 1]].reshape(-1, across[g])
        for b in range(len(found)):
            own = found[b, SIDE * groups[g] : SIDE * groups[g] + across[g]]
            _push(panel, rows[begins[g] : begins[g + 1]], own, found[b])


@sums
def _backwards(structure: Structure, numbers: Array64, found: Array64) -> None:
    """The same by the transpose, through all groups, from the last to the first."""
    groups, _, begins, rows, offsets, across, _, _, _ = structure
    for g in range(len(across) - 1, -1, -1):
        panel = numbers[offsets[g] : offsets[g + 1]].reshape(-1, across[g])
        for b in range(len(found)):
            own = found[b, SIDE * groups[g] : SIDE * groups[g] + across[g]]
            _pull(panel, rows[begins[g] : begins[g + 1]], own, found[b])


@inner_sums
def _push(panel: Array64, rows: NDArray[np.int32], own: Array64, found: Array64) -> None:
    """Solve for the numbers `own` of a panel among all that are `found` (6 n,), and take what they do to the `rows`
    below off these.
    """
    for i in range(len(own)):
        left = own[i]
        for c in range(i):
            left -= panel[i, c] * own[c]
        own[i] = left / panel[i, i]
    for i in range(len(rows)):
        products = _products(panel, len(own) + SIDE * i, own, len(own))
        for a in range(SIDE):
            found[SIDE * rows[i] + a] -= products[a]


@inner_sums
def _pull(panel: Array64, rows: NDArray[np.int32], own: Array64, found: Array64) -> None:
    """The same by the transpose: the effect of the `rows` below is taken off before."""
    for i in range(len(rows)):
        row, at = len(own) + SIDE * i, SIDE * rows[i]
        p, q, r, s, t, u = found[at], found[at + 1], found[at + 2], found[at + 3], found[at + 4], found[at + 5]
        for c in range(len(own)):
            own[c] -= (
                p * panel[row, c]
                + q * panel[row + 1, c]
                + r * panel[row + 2, c]
                + s * panel[row + 3, c]
                + t * panel[row + 4, c]
                + u * panel[row + 5, c]
            )
    for i in range(len(own) - 1, -1, -1):
        own[i] /= panel[i, i]
        for c in range(i):
            own[c] -= panel[i, c] * own[i]


@sums
def _invert_selected(structure: Structure, numbers: Array64, gains: Array64, summed: Array64, block: Array64) -> None:
    """Replace the numbers of a factor by those of the inverse; the rest is for use here."""
    _, _, begins, rows, offsets, across, _, _, _ = structure
    for g in range(len(across) - 1, -1, -1):
        panel, below = numbers[offsets[g] : offsets[g + 1]].reshape(-1, across[g]), rows[begins[g] : begins[g + 1]]
        width, length = across[g], len(panel)
        _divide_by_triangle(panel, gains, summed)
        for q in range(len(below)):
            begin = width + SIDE * q
            part = block[: SIDE * (length - begin)].reshape(SIDE, length - begin)
            _gather(structure, numbers, below[q:], part)
            for t in range(width):
                _add_both_ways(part, gains[t, begin:length], summed[t, begin:length])
        for t in range(width):
            for u in range(width):
                total = 0.0
                for i in range(length):
                    total += gains[t, i] * summed[u, i]
                panel[t, u] = total
        for i in range(width, length):
            for t in range(width):
                panel[i, t] = -summed[t, i]


@inner_sums
def _divide_by_triangle(panel: Array64, gains: Array64, summed: Array64) -> None:
    """Fill the columns of `gains` with the rows of a panel, divided from the right by its triangle, in whose place the
    identity is; `summed` has that part of them, and zeros.
    """
    width, length = panel.shape[1], len(panel)
    for t in range(width - 1, -1, -1):
        for i in range(length):
            gains[t, i] = panel[i, t] if i >= width else 0.0
        gains[t, t] = 1.0
        for c in range(t + 1, width):
            for i in range(length):
                gains[t, i] -= panel[c, t] * gains[c, i]
        inverse = 1.0 / panel[t, t]
        for i in range(length):
            gains[t, i] *= inverse
            summed[t, i] = gains[t, i] if i < width else 0.0


@inner
def _gather(structure: Structure, numbers: Array64, rows: NDArray[np.int32], block: Array64) -> None:
    """Fill in `block` (6, 6 r): the transpose of the inverse's blocks at these `rows` and the column of the first."""
    groups, group_of, begins, below, offsets, across, _, _, _ = structure
    g = group_of[rows[0]]
    first, p, panel = groups[g], begins[g], numbers[offsets[g] : offsets[g + 1]].reshape(-1, across[g])
    for r in range(len(rows)):
        at = SIDE * (rows[r] - first)
        if rows[r] >= groups[g + 1]:
            while below[p] != rows[r]:
                p += 1
            at = across[g] + SIDE * (p - begins[g])
        for a in range(SIDE):
            for c in range(SIDE):
                block[c, SIDE * r + a] = panel[at + a, SIDE * (rows[0] - first) + c]


@inner_sums
def _add_both_ways(block: Array64, gains: Array64, summed: Array64) -> None:
    """Add what the block (6, r), with its first square as a whole, takes `gains` (r,) to; and its transpose without."""
    p, q, r, s, t, u = gains[0], gains[1], gains[2], gains[3], gains[4], gains[5]
    products = _products(block, 0, gains, len(gains))
    for a in range(SIDE):
        summed[a] += products[a]
    for i in range(SIDE, len(summed)):
        summed[i] += (
            p * block[0, i] + q * block[1, i] + r * block[2, i] + s * block[3, i] + t * block[4, i] + u * block[5, i]
        )
