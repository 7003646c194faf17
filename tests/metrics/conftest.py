"""Walls drawn on a lattice, and wall sections found the slow way."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

CELL_M = 0.02


def wall(angle_deg: float, cells: float, *, half_length_cells: float = 70, size: int = 160, hits: int = 3):
    """Draw a straight wall: centres within ``cells - 1`` along the normal, 8-connected where that is 0."""
    row, col = np.mgrid[:size, :size] - size // 2
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    along, across = c * col + s * row, c * row - s * col
    wide = cells - 1 + max(abs(c), abs(s))
    drawn = (across >= -wide / 2 - 1e-9) & (across < wide / 2 - 1e-9) & (np.abs(along) <= half_length_cells)
    return np.where(drawn, hits, 0).astype(np.int32)


def noisy_wall(angle_deg: float, sigma_cells: float, *, returns: int = 12_000, size: int = 160, seed: int = 0):
    """Count returns scattered across a wall."""
    rng = np.random.default_rng(seed)
    along, across = rng.uniform(-70, 70, returns), rng.normal(0, sigma_cells, returns)
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    xy = np.column_stack((c * along - s * across, s * along + c * across)) + size / 2
    hits = np.zeros((size, size), np.int32)
    np.add.at(hits, tuple(np.floor(xy).astype(int).T[::-1]), 1)
    return hits


def naive_sections(hits, cell_m, min_hits, *, radius_m, min_cells, min_length_m, max_ratio, max_gap):
    """Follow docs/metrics.md to the letter: a sorted list of (row, col, thickness, length, vertical)."""
    found = []
    for vertical in (True, False):
        view = hits if vertical else hits.T
        cells = np.argwhere(view >= min_hits)
        for col in range(view.shape[1]):
            for run in split([r for r in range(view.shape[0]) if view[r, col] >= min_hits], max_gap):
                middle = np.array([(run[0] + run[-1]) / 2, col])
                near = cells[np.hypot(*(cells - middle).T) * cell_m <= radius_m]
                near = hanging_together(near, [(r, col) for r in run], max_gap)
                if len(near) < min_cells:
                    continue
                weights = view[tuple(near.T)]
                # rounded, so that a wall at 45 degrees is one of neither axis here, too
                (var_y, cov), (_, var_x) = np.cov(near.T, aweights=weights, ddof=0).round(12)
                thin, wide = np.linalg.eigvalsh([(var_y, cov), (cov, var_x)])
                if np.sqrt(12 * wide) * cell_m < min_length_m or thin > max_ratio * wide:
                    continue
                if not (var_x >= var_y if vertical else var_x > var_y):
                    continue
                normal = np.linalg.eigh([(var_y, cov), (cov, var_x)])[1][:, 0]
                share = abs(normal[0])
                place = (*middle,) if vertical else (*middle[::-1],)
                found.append((*place, (run[-1] - run[0]) * share + 1, cell_m / share, vertical))
    return sorted(found)


def hanging_together(cells, seeds, max_gap):
    """Keep the cells (n, 2) that are reached from the seeds over ``max_gap`` empty cells at a time."""
    left = set(map(tuple, cells.tolist()))
    reached, edge = set(), left & set(seeds)
    steps = range(-max_gap - 1, max_gap + 2)
    while edge:
        reached |= edge
        edge = {(r + a, c + b) for r, c in edge for a in steps for b in steps} & (left - reached)
    return np.array(sorted(reached)).reshape(-1, 2)


def split(rows, max_gap):
    """Split ascending rows where more than ``max_gap`` are missing."""
    runs = []
    for r in rows:
        if runs and r - runs[-1][-1] <= max_gap + 1:
            runs[-1].append(r)
        else:
            runs.append([r])
    return runs


@pytest.fixture(scope="session")
def walls() -> SimpleNamespace:
    return SimpleNamespace(cell_m=CELL_M, straight=wall, noisy=noisy_wall, naive=naive_sections)
