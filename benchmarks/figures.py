"""Draw the paper's Figures 2 to 8 anew with ``--method paper``, and print the numbers behind them.

    python benchmarks/figures.py [LOGS]

LOGS is a folder of recordings; Figure 4 needs ccny_demo/ccny_demo.mcap of it. The pictures are written to docs/paper/.
Missions are shown in the world frame: as in the paper, the pose of the first scan is known.
"""

from __future__ import annotations

import argparse
import sys
from math import radians
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.patches import Rectangle
from matplotlib.transforms import Affine2D

from mavnav.config.loading import load_config
from mavnav.ground_truth.map_file import occupied_xy_m
from mavnav.ground_truth.true_map import of_scenario
from mavnav.logs import open_log
from mavnav.mapping.occupancy_grid import known_part
from mavnav.metrics.map_distance import map_distance
from mavnav.metrics.map_quality import map_quality
from mavnav.metrics.trajectory_error import absolute_error, matched
from mavnav.metrics.wall_thickness import wall_thickness
from mavnav.outputs import drawing
from mavnav.outputs.map_picture import HIT_TICKS
from mavnav.outputs.run import Truth
from mavnav.pose import Pose, Trajectory
from mavnav.simulation.mission import Flight, fly
from mavnav.simulation.world import Scenario, laser_model, load_scenario, take_scan
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.metrics.ghost_walls import GhostWall
    from mavnav.scan import Scan

ROOT = Path(__file__).parent.parent
PICTURES = ROOT / "docs" / "paper"
CLOSE_UP = drawing.Window(2.3, 5.0, 1.8, 3.0)
"""Where the 5x5 map of the cart has most of its ghost walls, world frame."""


def draw_hits(axes: Axes, grid: Grid, world_T_map: Pose) -> None:
    """Draw the cells that were hit; the axes of the map may be rotated against those of the world."""
    known = known_part(grid, hits_only=True)
    (rows, cols), (x, y) = known.hits.shape, known.origin_xy_m
    extent = (x, x + cols * known.cell_m, y, y + rows * known.cell_m)
    moved = Affine2D().rotate(world_T_map.yaw_rad).translate(world_T_map.x_m, world_T_map.y_m) + axes.transData
    hits = np.ma.masked_equal(known.hits, 0)
    axes.imshow(hits, origin="lower", extent=extent, interpolation="nearest", cmap="viridis_r", transform=moved)


def finish(fig: Figure, name: str) -> None:
    """Give all maps one logarithmic colour scale, add colour bar and legend, and write the picture."""
    axes = fig.axes
    images = [image for ax in axes for image in ax.get_images()]
    top = float(np.quantile(np.concatenate([image.get_array().compressed() for image in images]), 0.995))
    for image in images:
        image.set_norm(LogNorm(1, top))
    ticks = [tick for tick in HIT_TICKS if tick <= top]
    bar = fig.colorbar(images[0], ax=axes, label="laser hits per cell", extend="max", ticks=ticks, format="%d")
    bar.minorticks_off()
    named = {label: mark for ax in axes for mark, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    fig.legend(named.values(), named.keys(), loc="outside lower center", ncols=6, frameon=False, fontsize=8.5)
    fig.set_layout_engine("compressed")
    PICTURES.mkdir(exist_ok=True)
    drawing.save(fig, PICTURES / f"{name}.png")


def report(name: str, outcome: SlamResult, truth: Trajectory | None = None, scenario: Scenario | None = None) -> None:
    """Print the metrics of a map; ``truth`` holds the true poses in the map frame, ``scenario`` the true walls."""
    walls = wall_thickness(outcome.grid.hits, outcome.grid.cell_m, 2)
    parts = [f"{name}: {outcome.tracked_share:.0%} of {len(outcome.steps)} scans accepted"]
    if truth is not None:
        poses, true = (p[:, :2] for p in matched(outcome.trajectory, truth))
        ate_mm, unaligned_mm = (absolute_error(poses, true, aligned=a).rmse_m / MM for a in (True, False))
        parts.append(f"ATE {ate_mm:.1f} mm ({unaligned_mm:.1f} mm unaligned)")
    if scenario is not None:
        true_map = of_scenario(scenario, scenario.world_T_base @ scenario.base_T_laser)
        parts.append(f"map to true walls p95 {map_distance(occupied_xy_m(outcome.grid), true_map).p95_mm:.0f} mm")
    parts.append(f"ghost walls {map_quality(outcome.grid).ghost_walls.length_m:.1f} m")
    parts.append(f"walls at >= 2 hits max {walls.max_cells:.1f}, p95 {walls.p95_cells:.1f} cells")
    print(", ".join(parts), flush=True)


def flown(name: str) -> tuple[Flight, Truth]:
    """Fly a mission; return it with the truth in the world frame."""
    flight = fly(load_scenario(name, [], {"seed": 0, "slam.method": "paper"}))
    world, true_poses = flight.scenario.world, flight.map_T_laser.seen_from(flight.world_T_map)
    return flight, Truth(true_poses, world.segments, world.arcs, flight.scenario.goals_xy_m[-1])


def mission(name: str, scenario: str, numbers: tuple[int, int]) -> None:
    """Figures 2 and 3, 5 and 6: a scenario, and the occupancy grid at the end of its mission."""
    flight, truth = flown(scenario)
    fig = drawing.figure(11.0, 5.5)
    left, right = fig.subplots(1, 2)
    drawing.draw_walls(left, truth, color=drawing.INK, lw=1.8, label="true wall")
    draw_hits(right, flight.slam.grid, flight.world_T_map)
    poses = flight.slam.trajectory.seen_from(flight.world_T_map)
    right.plot(*poses.xyyaw[:, :2].T, "o", ms=6, mfc="none", color=drawing.POSE_MAGENTA, label="estimated pose")
    right.plot(*truth.map_T_laser.xyyaw[:, :2].T, "x", ms=4, color="black", label="true pose")
    window = drawing.window_around(np.vstack(drawing.wall_lines(truth)), least_margin_m=0.15)
    start, ahead = truth.map_T_laser[0], truth.map_T_laser[0] @ Pose(0.08 * max(window.size_m))
    left.annotate("", ahead[:2], start[:2], arrowprops={"arrowstyle": "-|>", "color": drawing.POSE_MAGENTA, "lw": 1.8})
    for ax, number, title in zip((left, right), numbers, (f"scenario {scenario}", "final occupancy grid"), strict=True):
        drawing.draw_ends(ax, start[:2], truth.goal_xy_map_m, "goal (reached within 250 mm)")
        drawing.dress(ax, window)
        ax.set_title(f"Figure {number}: {title}", fontsize=10)
    finish(fig, name)
    report(f"{name}: {flight.mission.end}", flight.slam, flight.map_T_laser, flight.scenario)


def recorded(name: str, path: Path) -> None:
    """Figure 4: a log of the paper's own sensor, moved by hand; the truth is not known."""
    if not path.exists():
        print(f"{name}: skipped, {path} does not exist", file=sys.stderr)
        return
    log = open_log(path, odom="off")
    outcome = run_slam(log.scans, load_config("paper"), log.period_s)
    fig, xy_m = drawing.figure(6.0, 8.0), outcome.trajectory.xyyaw[:, :2]
    axes = fig.add_subplot()
    draw_hits(axes, outcome.grid, Pose())
    axes.plot(*xy_m.T, "-", lw=1.2, color=drawing.POSE_MAGENTA, label="estimated path")
    drawing.draw_ends(axes, xy_m[0], xy_m[-1], "end")
    drawing.dress(axes, drawing.window_of(outcome.grid, xy_m))
    axes.set_title("Figure 4: laser moved by hand (ccny_demo)", fontsize=10)
    finish(fig, name)
    report(name, outcome)


def corridor(name: str) -> None:
    """Figure 7: the scans and commands of one mission, replayed with a coarse and a fine search grid."""
    flight, truth = flown("corridor")
    (x0, y0, x1, y1), odometry = (
        flight.scenario.world.bounds_m,
        flight.odom_T_base.compose(flight.scenario.base_T_laser),
    )
    fig, cpu_s, evaluations = drawing.figure(11.0, 5.6), [], []
    for ax, (yaws, grid) in zip(fig.subplots(2, 1, sharex=True), ((20, "10x10"), (40, "40x40")), strict=True):
        config, began_s = load_config("paper", [], {"grid": grid, "azimuth": yaws}), process_time()
        outcome = run_slam(lambda: iter(flight.scans), config, 0.1, odometry)
        cpu_s.append(process_time() - began_s)
        evaluations.append(outcome.steps.column("evaluations").mean())
        draw_hits(ax, outcome.grid, flight.world_T_map)
        drawing.draw_walls(ax, truth, color=drawing.GOAL_RED, lw=0.9, ls=(0, (4, 3)), label="true wall")
        drawing.dress(ax, drawing.Window(x0 - 0.3, x1 + 0.3, y0 - 0.3, y1 + 0.3))
        ax.label_outer()
        ax.set_title(f"Figure 7: {yaws} yaw samples / {grid}", fontsize=10)
        report(f"{name} {yaws} / {grid}", outcome, flight.map_T_laser, flight.scenario)
    finish(fig, name)
    each = " and ".join(f"{n:.0f}" for n in evaluations)
    print(
        f"{name}: 40 / 40x40 takes {cpu_s[1] / cpu_s[0]:.1f} times the CPU time, {each} evaluations a scan", flush=True
    )


def cart() -> tuple[list[Scan], Trajectory]:
    """Push a cart through the corridor as test_fig8 does; return its scans and true poses (world frame)."""
    scenario = load_scenario("corridor", ["laser.noise_percent=0.2"])
    rng, scans, poses, (x_m, y_m, yaw_rad) = np.random.default_rng(10), [], [], (0.8, 1.0, 0.0)
    for k in range(40):
        poses.append(Pose(x_m, y_m, yaw_rad))
        scans.append(take_scan(scenario.world, poses[-1], laser_model(scenario), rng, k * 10**8))
        x_m += 0.1 + rng.normal(0, 0.005)
        y_m += rng.normal(0, 0.005) - 0.1 * (y_m - 1.0)
        yaw_rad = 0.7 * yaw_rad + rng.normal(0, radians(1))
    return scans, Trajectory.of([scan.stamp_ns for scan in scans], poses)


def ring(axes: Axes, ghost: GhostWall, world_T_map: Pose) -> None:
    """Frame a ghost wall: the ridge in front, and the rear one farther from the laser's path (y = 0 in the map)."""
    front = world_T_map @ Pose(ghost.x_m, ghost.y_m, (ghost.direction_deg + 90.0) % 180.0 * DEG)
    middle = front @ Pose(np.sign(ghost.y_m) * ghost.offset_mm * MM / 2.0)
    long, wide = ghost.length_m + 0.1, ghost.offset_mm * MM + 0.1
    corner, turned = (middle.x_m - long / 2.0, middle.y_m - wide / 2.0), middle.yaw_rad / DEG - 90.0
    style = {"fill": False, "edgecolor": drawing.GOAL_RED, "lw": 1.3, "label": "ghost wall"}
    axes.add_patch(Rectangle(corner, long, wide, angle=turned, rotation_point="center", **style))


def grids(name: str) -> None:
    """Figure 8: close-ups of the maps of three search grids, with the preset ``fig8``."""
    (scans, truth), walls = cart(), flown("corridor")[1]
    fig = drawing.figure(13.0, 2.9)
    for ax, (yaws, grid) in zip(fig.subplots(1, 3), ((10, "5x5"), (20, "10x10"), (40, "20x20")), strict=True):
        outcome = run_slam(lambda: iter(scans), load_config("fig8", [], {"grid": grid, "azimuth": yaws}), 0.1)
        drawing.draw_walls(ax, walls, color=drawing.PATH_GREY, lw=0.8, zorder=-1, label="true wall")
        draw_hits(ax, outcome.grid, truth[0])
        for ghost in map_quality(outcome.grid).ghost_walls.places:
            ring(ax, ghost, truth[0])
        drawing.dress(ax, CLOSE_UP)
        ax.label_outer()
        ax.set_title(f"Figure 8: {yaws} yaw samples / {grid}", fontsize=10)
        report(f"{name} {yaws} / {grid}", outcome, truth.seen_from(truth[0].inverse()))
    finish(fig, name)


def main() -> None:
    """Draw all figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="?", default=ROOT.parent / "shared" / "logs")
    logs = parser.parse_args().logs
    mission("fig2_3_corner", "corner-paper", (2, 3))
    recorded("fig4_ccny_demo", logs / "ccny_demo" / "ccny_demo.mcap")
    mission("fig5_6_complex", "complex", (5, 6))
    corridor("fig7_corridor")
    grids("fig8_grids")


if __name__ == "__main__":
    main()
