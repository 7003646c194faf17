"""Draw the paper's Figures 2 to 8 with ``--method paper``, and print the metrics of every map.

    python benchmarks/figures.py [LOGS]

LOGS (../shared/logs) is a folder of recordings; Figure 4 needs ccny_demo/ccny_demo.mcap. Pictures go to docs/paper/.
Missions are shown in the world frame: as in the paper, the pose of the first scan is known.
"""

from __future__ import annotations

import sys
from math import radians
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator
from matplotlib.transforms import Affine2D

from mavnav.config.loading import load_config
from mavnav.ground_truth.references import References, compare_to, of_scenario
from mavnav.logs import open_log
from mavnav.mapping.occupancy_grid import Grid, occupied_xy_m
from mavnav.metrics.ghost_walls import GhostWall
from mavnav.metrics.map_quality import measure_map
from mavnav.metrics.reference import AlignedError, MapDistance, Reference
from mavnav.metrics.walls import summary, wall_sections
from mavnav.outputs.pictures.canvas import DPI, GOAL_RED, INK, MUTED, PATH_GREY, POSE_MAGENTA, START_BLUE
from mavnav.outputs.pictures.map_axes import Viewport, wall_lines, window_around, window_of
from mavnav.outputs.run import Truth
from mavnav.pose import Pose, Trajectory
from mavnav.scan import Scan
from mavnav.simulation.mission import Flight, fly
from mavnav.simulation.world.laser import take_scan
from mavnav.simulation.world.scenario import Scenario, laser_model
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.units import DEG, MM

PICTURES = Path(__file__).parent.parent / "docs" / "paper"


def figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure."""
    return Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained", facecolor="white")


def draw_walls(axes: Axes, truth: Truth, label: str, **style: Any) -> None:
    """Draw the true walls; only the first one has the label."""
    for k, line in enumerate(wall_lines(truth)):
        axes.plot(*line.T, label=None if k else label, **style)


def mark_ends(axes: Axes, start_xy_m: Any, end_xy_m: Any, end: str) -> None:
    """Mark the start by a blue x, the end or goal by a red circle with an x."""
    axes.plot(*start_xy_m, "x", ms=10, color=START_BLUE, mew=2.4, label="start", zorder=5)
    axes.plot(*end_xy_m, marker="$\\bigotimes$", ls="none", ms=13, color=GOAL_RED, mew=0.3, label=end, zorder=5)


def draw_frame(axes: Axes, window: Viewport) -> None:
    """Set limits, equal aspect, labels and grey spines."""
    axes.set(xlim=(window.x0_m, window.x1_m), ylim=(window.y0_m, window.y1_m), xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal")
    axes.tick_params(colors=MUTED, labelsize=8)
    axes.spines[:].set_color("#cccccc")


def draw_hits(axes: Axes, grid: Grid, world_T_map: Pose) -> None:
    """Draw the cells with hits; the map may be rotated relative to the world."""
    (rows, cols), (x, y), hits = grid.hits.shape, grid.origin_xy_m, np.ma.masked_equal(grid.hits, 0)
    extent = (x, x + cols * grid.cell_m, y, y + rows * grid.cell_m)
    moved = Affine2D().rotate(world_T_map.yaw_rad).translate(world_T_map.x_m, world_T_map.y_m) + axes.transData
    axes.imshow(hits, origin="lower", extent=extent, interpolation="nearest", cmap="viridis_r", transform=moved)


def finish(fig: Figure, name: str, window: Viewport) -> None:
    """Set a common frame and a logarithmic color scale for all maps, add color bar and legend, and write the figure."""
    axes, images = fig.axes, [image for ax in fig.axes for image in ax.get_images()]
    top = float(np.quantile(np.concatenate([np.ma.compressed(image.get_array()) for image in images]), 0.995))
    for image in images:
        image.set_norm(LogNorm(1, top))
    for ax in axes:
        draw_frame(ax, window)
        ax.label_outer()
        ax.title.set_fontsize(10)
    bar = fig.colorbar(images[0], ax=axes, ticks=LogLocator(subs=(1, 2, 5)), format="%d", extend="max", pad=0.01)
    bar.minorticks_off()
    bar.set_label("laser hits per cell")
    named = {label: mark for ax in axes for mark, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    fig.legend(named.values(), named.keys(), loc="outside lower center", ncols=6, frameon=False, fontsize=8.5)
    fig.set_layout_engine("compressed")
    PICTURES.mkdir(exist_ok=True)
    fig.savefig(PICTURES / f"{name}.png", metadata={"Software": None}, bbox_inches="tight")


def report(name: str, outcome: SlamResult, truth: Trajectory | None = None, scenario: Scenario | None = None) -> None:
    """Print the metrics of a map; ``truth`` are the true poses in the map frame, ``scenario`` has the true walls."""
    true_map = of_scenario(scenario, scenario.world_T_base @ scenario.base_T_laser) if scenario else None
    errors = compare_to(References(truth, true_map), outcome.trajectory, occupied_xy_m(outcome.grid)) or Reference()
    walls = summary(wall_sections(outcome.grid.hits, outcome.grid.cell_m, 2), outcome.grid.cell_m)
    parts = [f"{name}: {outcome.tracked_share:.0%} of {len(outcome.steps)} scans accepted"]
    if isinstance(ate := errors.ate, AlignedError):
        parts.append(f"ATE {ate.rmse_m / MM:.1f} mm ({ate.unaligned_rmse_m / MM:.1f} mm unaligned)")
    if isinstance(distance := errors.map_distance, MapDistance):
        parts.append(f"map to true walls p95 {distance.p95_mm:.0f} mm")
    parts.append(f"ghost walls {measure_map(outcome.grid).quality.ghost_walls.length_m:.1f} m")
    parts.append(f"walls at >= 2 hits max {walls.max_cells:.1f}, p95 {walls.p95_cells:.1f} cells")
    print(", ".join(parts), flush=True)


def flown(name: str) -> tuple[Flight, Truth]:
    """Fly a mission; return it, and the true poses, true walls and goal in the world frame."""
    flight = fly(load_scenario(name, [], {"seed": 0, "slam.method": "paper"}))
    return flight, truth_of(flight.scenario, flight.map_T_laser.seen_from(flight.world_T_map))


def truth_of(scenario: Scenario, world_T_laser: Trajectory) -> Truth:
    """Return true poses, true walls and goal in the world frame."""
    walls, goal_xy_m = scenario.world, scenario.goals_xy_m[-1]
    return Truth(walls.segments, walls.arcs, map_T_laser=world_T_laser, goal_xy_map_m=goal_xy_m)


def mission(name: str, scenario: str, titles: tuple[str, str]) -> None:
    """Draw Figures 2 and 3, or 5 and 6: a scenario, and the occupancy grid at the end of its mission."""
    (flight, truth), fig = flown(scenario), figure(11.0, 5.5)
    left, right = fig.subplots(1, 2)
    draw_walls(left, truth, color=INK, lw=1.8, label="true wall")
    draw_hits(right, flight.slam.grid, flight.world_T_map)
    poses = flight.slam.trajectory.seen_from(flight.world_T_map)
    right.plot(*poses.xyyaw[:, :2].T, "o", ms=6, mfc="none", color=POSE_MAGENTA, label="estimated pose")
    right.plot(*truth.map_T_laser.xyyaw[:, :2].T, "x", ms=4, color="black", label="true pose")
    window = window_around(np.vstack(wall_lines(truth)), least_margin_m=0.15)
    start, ahead = truth.map_T_laser[0], truth.map_T_laser[0] @ Pose(0.08 * max(window.size_m))
    left.annotate("", ahead[:2], start[:2], arrowprops={"arrowstyle": "-|>", "color": POSE_MAGENTA, "lw": 1.8})
    for ax, title in zip((left, right), titles, strict=True):
        mark_ends(ax, start[:2], truth.goal_xy_map_m, "goal (within 250 mm counts)")
        ax.set_title(title)
    finish(fig, name, window)
    goal = "goal reached" if flight.mission.reached else "goal missed"
    report(f"{name}: {goal}", flight.slam, flight.map_T_laser, flight.scenario)


def recorded(name: str, path: Path) -> None:
    """Draw Figure 4: a log of the paper's sensor, moved by hand, without ground truth."""
    if not path.exists():
        print(f"{name}: skipped, {path} does not exist", file=sys.stderr)
        return
    log = open_log(path, odom="off")
    outcome = run_slam(log.scans, load_config("paper"), log.period_s)
    fig, xy_m = figure(6.0, 8.0), outcome.trajectory.xyyaw[:, :2]
    axes = fig.add_subplot()
    draw_hits(axes, outcome.grid, Pose())
    axes.plot(*xy_m.T, "-", lw=1.2, color=POSE_MAGENTA, label="estimated path")
    mark_ends(axes, xy_m[0], xy_m[-1], "end")
    axes.set_title("Figure 4: laser moved by hand (ccny_demo)")
    finish(fig, name, window_of(outcome.grid, xy_m))
    report(name, outcome)


def corridor(name: str) -> None:
    """Draw Figure 7: the scans and commands of one mission, replayed with a coarse and a fine search grid."""
    (flight, truth), fig, effort = flown("corridor"), figure(11.0, 5.6), []
    for ax, (yaws, grid) in zip(fig.subplots(2, 1, sharex=True), ((20, "10x10"), (40, "40x40")), strict=True):
        config, clock_s = load_config("paper", [], {"grid": grid, "azimuth": yaws}), [process_time()]
        for _ in range(3):  # the minimum time is used
            outcome = run_slam(lambda: iter(flight.scans), config, 0.1, flight.odom_T_base)
            clock_s.append(process_time())
        effort.append((np.diff(clock_s).min(), outcome.steps.column("evaluations").mean()))
        draw_hits(ax, outcome.grid, flight.world_T_map)
        draw_walls(ax, truth, color=GOAL_RED, lw=0.9, ls=(0, (4, 3)), label="true wall")
        ax.set_title(f"Figure 7: {yaws} yaw samples / {grid}")
        report(f"{name} {yaws} / {grid}", outcome, flight.map_T_laser, flight.scenario)
    x0, y0, x1, y1 = flight.scenario.world.bounds_m
    finish(fig, name, Viewport(x0 - 0.3, x1 + 0.3, y0 - 0.3, y1 + 0.3))
    (coarse_s, few), (fine_s, many) = effort
    print(f"{name}: CPU time ratio {fine_s / coarse_s:.1f}, {few:.0f} and {many:.0f} evaluations a scan", flush=True)


def cart(scenario: Scenario) -> tuple[list[Scan], Trajectory]:
    """Simulate a cart in the corridor as in the test of Figure 8; return its scans and true poses, world frame."""
    rng, scans, poses, (x_m, y_m, yaw_rad) = np.random.default_rng(22), [], [], (0.8, 1.0, 0.0)
    for k in range(40):
        poses.append(Pose(x_m, y_m, yaw_rad))
        scans.append(take_scan(scenario.world, poses[-1], laser_model(scenario), rng, k * 10**8))
        x_m += 0.1 + rng.normal(0, 0.005)
        y_m += rng.normal(0, 0.005) - 0.1 * (y_m - 1.0)
        yaw_rad = 0.7 * yaw_rad + rng.normal(0, radians(1))
    return scans, Trajectory.of([scan.stamp_ns for scan in scans], poses)


def ring(axes: Axes, ghost: GhostWall, world_T_map: Pose) -> None:
    """Draw a rectangle around a ghost wall and its wall, which is nearer to the laser's path (y = 0 in the map)."""
    front = Pose(ghost.x_m, ghost.y_m, (ghost.direction_deg + 90.0) % 180.0 * DEG)
    x, y, yaw_rad = world_T_map @ front @ Pose(np.sign(ghost.y_m) * ghost.offset_mm * MM / 2.0)
    deep, long = ghost.offset_mm * MM + 0.1, ghost.length_m + 0.1
    box = Rectangle((x - deep / 2.0, y - long / 2.0), deep, long, angle=yaw_rad / DEG, rotation_point="center")
    axes.add_patch(box).set(fill=False, edgecolor=GOAL_RED, lw=1.3, label="ghost wall: a wall drawn twice")


def grids(name: str) -> None:
    """Draw Figure 8: close-ups of three search grids, preset ``fig8``, at the longest ghost wall of the first one."""
    scenario = load_scenario("corridor", ["laser.noise_percent=0.2"])
    (scans, way), fig, found = cart(scenario), figure(13.0, 2.9), []
    truth = truth_of(scenario, way)
    for ax, (yaws, grid) in zip(fig.subplots(1, 3), ((10, "5x5"), (20, "10x10"), (40, "20x20")), strict=True):
        outcome = run_slam(lambda: iter(scans), load_config("fig8", [], {"grid": grid, "azimuth": yaws}), 0.1)
        draw_walls(ax, truth, color=PATH_GREY, lw=0.8, zorder=-1, label="true wall")
        draw_hits(ax, outcome.grid, way[0])
        for ghost in measure_map(outcome.grid).quality.ghost_walls.places:
            ring(ax, ghost, way[0])
            found.append(way[0] @ Pose(ghost.x_m, ghost.y_m))
        ax.set_title(f"Figure 8: {yaws} yaw samples / {grid}")
        report(f"{name} {yaws} / {grid}", outcome, way.seen_from(way[0].inverse()))
    x, y, _ = (found or way)[0]
    finish(fig, name, Viewport(x - 1.35, x + 1.35, y - 0.6, y + 0.6))


def main() -> None:
    """Draw all figures."""
    logs = Path(sys.argv[1] if len(sys.argv) > 1 else "../shared/logs")
    mission("fig2_3_corner", "corner-paper", ("Figure 2: scenario corner-paper", "Figure 3: final occupancy grid"))
    recorded("fig4_ccny_demo", logs / "ccny_demo" / "ccny_demo.mcap")
    mission("fig5_6_complex", "complex", ("Figure 5: scenario complex", "Figure 6: final occupancy grid"))
    corridor("fig7_corridor")
    grids("fig8_grids")


if __name__ == "__main__":
    main()
