"""Trials of what refusals of command lines advise: a part of the message, the line that causes it, those that it names.

The lines are for the folder of `commands.test_advice_on_commands`: small logs, runs, and runs that lack something.
"""

from __future__ import annotations

SHORT = "-q --end 0.6 --online"
FAST = f"{SHORT} --odom off --outputs trajectory"
CALIBRATE = "calibrate long.mcap --topic /scan --odom /odom -q"

TRIALS = [
    (
        "several scan topics (/rear, /scan); a replay needs --topic",
        "info two.mcap",
        f"replay two.mcap --topic /scan -o new {FAST}",
    ),
    (
        "--attitude is that of one laser; several --topic",
        "replay lasers.mcap --topic /scan,/rear --attitude /odom",
        f"replay lasers.mcap --topic /scan --attitude /odom -o new {FAST}",
    ),
    (
        "--extrinsic is the pose of one laser; several --topic",
        "replay lasers.mcap --topic /scan,/rear --extrinsic 0,0,0",
        f"replay lasers.mcap --topic /scan --extrinsic 0,0,0 -o new {FAST}",
        f"replay lasers.mcap --topic /scan,/rear -o both {FAST}",
    ),
    (
        "upside_down is of one laser; several --topic",
        "replay lasers.mcap --topic /scan,/rear --set upside_down=true",
        f"replay lasers.mcap --topic /scan,/rear -o new {FAST}",
    ),
    (
        "record /tf_static, or choose one --topic",
        "replay loose.mcap --topic /scan,/rear",
        f"replay two.mcap --topic /scan -o new {FAST}",
        f"replay lasers.mcap --topic /scan,/rear -o all {FAST}",
    ),
    (
        "a map has no poses; --truth and --relations are not used for it",
        "metrics run run/map.yaml --truth run/trajectory.tum",
        "metrics run --truth run/trajectory.tum",
    ),
    ("examine the log with 'mavnav info'", "metrics nowhere", "info blind.mcap"),
    (
        "is a mission of mavnav simulate; record it with mavnav simulate --record, and replay the recording",
        "replay next.mcap --continue mission",
        "simulate short.yaml -o flown --record flown.mcap -q",
        f"replay flown.mcap -o new {FAST}",
    ),
    (
        "is of another command; write mavnav simulate --again mission",
        "replay --again mission -o wrong",
        "simulate --again mission -o new -q",
    ),
    (
        "choose another name for the recording, or --force",
        "simulate short.yaml -o wrong --record old.mcap",
        "simulate short.yaml -o new --record old.mcap --force -q",
    ),
    (
        "choose another file, or --force",
        "simulate short.yaml -o wrong --animate old.gif",
        "simulate short.yaml -o new --animate old.gif --force -q",
    ),
    (
        "check that the map is of this place; give another --start-pose",
        "replay blind.mcap --map run --start-pose 0,0,0 -q -o off",
        f"replay log.mcap --map run --start-pose 0,0,0 -o new {FAST}",
    ),
    (
        "exists; choose another directory with -o, or --force",
        "replay log.mcap -o run",
        f"replay log.mcap -o again {FAST}",
        f"replay log.mcap -o again --force {FAST}",
    ),
    ("exists; choose another file, or --force", "diff run run -o old.png", "diff run run -o old.png --force"),
    (
        "exists; choose another name, or --force to replace it",
        "convert log.mcap old.mcap",
        "convert log.mcap old.mcap --force",
    ),
    (
        "name the map with --map",
        "replay log.mcap --start-pose 0,0,0",
        f"replay log.mcap --start-pose 0,0,0 --map run -o new {FAST}",
    ),
    (
        "the map is in the frame of the one given by --map or --continue; leave out --align",
        "replay log.mcap --align walls --map run",
        f"replay log.mcap --map run -o new {FAST}",
    ),
    (
        "--align draws the finished map again; leave out --online, and use --method robust",
        "replay log.mcap --align walls --online",
        "replay log.mcap --align walls --end 2 -q -o new",
    ),
    ("no log; name one, or a run directory with --again", "replay", "replay --again run -o new -q"),
    (
        "--preview is drawn from map; add it to --outputs",
        "replay log.mcap --preview --outputs trajectory",
        f"replay log.mcap --preview -o new {FAST},map",
    ),
    (
        "takes --end from the run; leave one of them out",
        "replay --again run --end 1 -o wrong",
        "replay --again run -o new -q",
    ),
    ("write mavnav replay LOG --again", "replay --again moved -o wrong", "replay log.mcap --again moved -o new -q"),
    (
        "name the right one, or leave out --again",
        "replay two.mcap --again run -o wrong",
        f"replay two.mcap --topic /scan -o new {FAST}",
    ),
    (
        "repeat it by its configuration, with --config",
        "replay --again early -o wrong",
        f"replay log.mcap --config early.json -o new {FAST}",
    ),
    (
        "run several logs with 'mavnav batch LOG ...', or name parts drive_0.mcap",
        "info log.mcap two.mcap",
        "info drive_0.mcap drive_1.mcap",
        f"batch log.mcap bare.mcap {SHORT} -o new -j 1",
    ),
    (
        "parts of a log are files; fetch what lies elsewhere, or run several logs",
        "info drive_0.mcap -",
        "info drive_0.mcap drive_1.mcap",
    ),
    ("use 'mavnav batch FOLDER'", "info logs", f"batch logs {SHORT} -o new -j 1"),
    (
        "is empty; --end must be later than --start",
        "replay log.mcap --start 1 --end 0.5",
        f"replay log.mcap --start 0.1 -o new {FAST}",
    ),
    (
        "report is drawn from trajectory and map; add them",
        "replay log.mcap --report --outputs metrics",
        f"replay log.mcap --report -o new {FAST},map",
    ),
    ("--outputs: unknown", "replay log.mcap --outputs maps", f"replay log.mcap -o new {FAST},map"),
    (
        "write for example --gate 'wall_thickness.p95_mm<=150'",
        "check run --gate thin",
        "check run --gate wall_thickness.p95_mm<=150",
    ),
    (
        "it needs --truth, --truth-map or --relations",
        "check run --gate reference.ate.rmse_m<=1",
        f"replay log.mcap --truth run/trajectory.tum --gate reference.ate.rmse_m<=1 -o new {FAST}",
    ),
    (
        "makes a map of its own; use --method robust",
        "replay log.mcap --method paper --map run",
        f"replay log.mcap --method robust --map run -o new {FAST}",
    ),
    (
        "leave out --start, or give the true walls",
        "replay log.mcap --truth-map corner.yaml --start 0.2",
        f"replay log.mcap --truth-map corner.yaml -o new {FAST}",
    ),
    (
        "--continue and --map both give a map; leave one of them out",
        "replay next.mcap --continue run --map run",
        "replay next.mcap --continue run -o new -q",
    ),
    (
        "cannot search whole maps; use the robust method",
        "replay next.mcap --continue run --method paper",
        "replay next.mcap --continue run --method robust -o new -q",
    ),
    (
        "has the map of another run (--map); continue that run",
        "replay next.mcap --continue located",
        "replay next.mcap --continue run -o new -q",
    ),
    (
        "cannot search whole maps; repeat it with --method robust",
        "replay next.mcap --continue paper",
        "replay log.mcap --method robust -o new -q",
        "replay next.mcap --continue new -o next -q",
    ),
    (
        "altered; make it again with mavnav replay",
        "replay next.mcap --continue early",
        "replay log.mcap -o early --force -q",
        "replay next.mcap --continue early -o new -q",
    ),
    (
        "make it again with mavnav replay --force",
        "metrics broken",
        "replay log.mcap -o broken --force -q",
        "metrics broken",
    ),
    (
        "has been altered since it was written; get it again",
        "merge spoilt next.mcap",
        "replay log.mcap -o spoilt --force -q",
        "merge spoilt next.mcap -o new -q",
    ),
    (
        "write mavnav replay two.mcap --topic NAME, and merge that run",
        "merge two.mcap next.mcap",
        "replay two.mcap --topic /scan -o front -q",
        "merge front next.mcap -o new -q",
    ),
    (
        "has several sessions; add others to it with mavnav replay --continue",
        "merge merged last.mcap",
        "replay last.mcap --continue merged -o new -q",
    ),
    (
        "repeat its command with --force, without --outputs",
        "metrics small",
        "replay log.mcap -o small --force -q",
        "metrics small",
    ),
    (
        "bare is no whole run: it has no result.mcap; repeat its command with --force, without --outputs",
        "merge bare next.mcap",
        "replay log.mcap -o whole -q",
        "merge whole next.mcap -o joined -q",
    ),
    (
        "the run has no map; repeat its command with --force, without --outputs",
        "check bare --gate map.cells>=1",
        "replay log.mcap -o bare --force -q",
        "check bare --gate map.cells>=1",
    ),
    (
        "--truth and --relations need a run directory",
        "metrics run/map.yaml --truth run/trajectory.tum",
        "metrics run --truth run/trajectory.tum",
    ),
    (
        "is for replay and compare; name a TUM file",
        "metrics run --truth auto",
        "metrics run --truth run/trajectory.tum",
    ),
    ("--gate: diff has no number walls; it has", "diff run run --gate walls<=1", "diff run run --gate changed_m2<=1"),
    ("name a run directory (mavnav replay makes one from a log)", "diff log.mcap run", "diff run run"),
    (
        "compare one log at a time with them",
        "compare log.mcap two.mcap --truth run/trajectory.tum",
        "compare log.mcap --truth run/trajectory.tum --online --end 0.6 --grid 5x5 -o new -q",
    ),
    (
        "is not key=value; write for example --set robust.cell_mm=25",
        "replay log.mcap --set robust.cell_mm",
        f"replay log.mcap --set robust.cell_mm=25 -o new {FAST}",
    ),
    (
        "sets more than one value; write for example --set robust.cell_mm=25",
        "replay log.mcap --set 'robust={cell_mm: 25, far_mm: 9000}'",
        f"replay log.mcap --set robust.cell_mm=25 -o new {FAST}",
    ),
    ("write for example --grid 10x10", "replay log.mcap --grid 1x1", f"replay log.mcap --grid 10x10 -o new {FAST}"),
    (
        "give it with --truth",
        "replay log.mcap --relations run/trajectory.tum",
        f"replay log.mcap --truth run/trajectory.tum -o new {FAST}",
    ),
    ("leave --set and --config", "calibrate long.mcap --set method=paper", CALIBRATE),
    ("leave --odom off away, or name a topic", "calibrate long.mcap --set odom=off", CALIBRATE),
    ("name one --topic at a time", "calibrate two.mcap --topic /scan,/rear", CALIBRATE),
    ("or one of 'mavnav simulate --list'", "simulate", "simulate --list"),
    ("choose one with --topic NAME", "replay two.mcap", f"replay two.mcap --topic /rear -o new {FAST}"),
    (
        "or merge them in a replay with their names, joined by a comma",
        "replay lasers.mcap",
        f"replay lasers.mcap --topic /scan,/rear -o new {FAST}",
    ),
    (
        "write it in small letters, --odom",
        "replay long.mcap --topic /scan --odom OFF",
        f"replay long.mcap --topic /scan --odom off -o new {SHORT}",
    ),
    ("the log holds none, leave --odom out", "replay bare.mcap --odom /odom", f"replay bare.mcap -o new {SHORT}"),
    (
        "name one of them, or write --attitude off",
        "replay log.mcap --attitude /tilt",
        f"replay log.mcap --attitude off -o new {FAST}",
    ),
    (
        "give topic:NAME of one with poses, or a file",
        "replay log.mcap --truth auto",
        f"replay log.mcap --truth topic:/odom -o new {FAST}",
    ),
    (
        "choose one with --truth topic:NAME",
        "replay truths.mcap --truth auto",
        f"replay truths.mcap --truth topic:/gt -o new {FAST}",
    ),
    (
        "No such option: --reslution; write --resolution",
        "replay log.mcap --reslution 0.05",
        f"replay log.mcap --resolution 0.05 -o new {FAST}",
    ),
    ("see 'mavnav replay --help'", "replay log.mcap --resolve 0.05", "replay --help"),
    (
        "values of --azimuth for 1 grids",
        "batch log.mcap --grid 5x5 --azimuth 6 --azimuth 8",
        f"batch log.mcap --grid 5x5 --azimuth 6 {SHORT} -o new -j 1",
    ),
    ("write for example --part 1/4", "batch log.mcap --part 4", f"batch log.mcap --part 1/1 {SHORT} -o new -j 1"),
    (
        "write for example --tolerance timing.cpu_s=50%",
        "batch log.mcap --baseline kept.json --tolerance cpu",
        f"batch log.mcap --baseline kept.json --tolerance timing.cpu_s=5000% {SHORT} -o new -j 1",
    ),
    (
        "write for example --tolerance wall_thickness.p95_mm=5%",
        "batch log.mcap --baseline kept.json --tolerance wall_thickness.p95_mm=x",
        f"batch log.mcap --baseline kept.json --tolerance wall_thickness.p95_mm=5% {SHORT} -o new -j 1",
    ),
    (
        "name an earlier batch, or make one with --update-baseline",
        "batch log.mcap --baseline gone.json",
        f"batch log.mcap --baseline made.json --update-baseline {SHORT} -o new -j 1",
    ),
    (
        "no baseline; name one with --baseline",
        "batch log.mcap --update-baseline",
        f"batch log.mcap --baseline made.json --update-baseline {SHORT} -o new -j 1",
    ),
    (
        "name a file for --update-baseline to write",
        "batch log.mcap --baseline run --update-baseline",
        f"batch log.mcap --baseline made.json --update-baseline --force {SHORT} -o new -j 1",
    ),
    (
        "would be lost; name another file for --update-baseline",
        "batch log.mcap --baseline first/batch.json --update-baseline",
        f"batch log.mcap --baseline made.json --update-baseline {SHORT} -o new -j 1",
    ),
    (
        "compares repeated runs; add --repeat 2",
        "batch log.mcap --gate identical",
        f"batch log.mcap --gate identical --repeat 2 {SHORT} -o new -j 1",
    ),
    (
        "give one of them",
        "batch log.mcap --part 1/2 --baseline made.json --update-baseline",
        f"batch log.mcap --part 1/1 {SHORT} -o new -j 1",
    ),
    (
        "write 'mavnav compare LOG --set KEY=A,B'",
        "sweep log.mcap",
        f"compare log.mcap --set odom=auto,off {SHORT} -o new",
    ),
    ("write 'mavnav batch benchmark'", "benchmark log.mcap", "batch benchmark --help"),
    ("write 'mavnav convert LOG OUT.mcap'", "export log.mcap", "convert log.mcap made.mcap --force"),
    ("write 'mavnav merge RUN RUN'", "join run merged", "merge run next.mcap -o new -q"),
    ("write 'mavnav replay LOG --map MAP'", "localize log.mcap", f"replay log.mcap --map run -o new {FAST}"),
    (
        "write 'mavnav replay LOG', then 'mavnav view RUN', which plays the scans",
        "play log.mcap",
        f"replay log.mcap -o new {SHORT}",
        "view new --no-browser",
    ),
    (
        "write --end SECONDS, counted from the first scan as --start is",
        "replay log.mcap --duration 0.6",
        f"replay log.mcap -o new {FAST}",
    ),
    (
        "leave it out; 'mavnav view RUN' shows the result",
        "replay log.mcap --rviz",
        f"replay log.mcap -o new {SHORT}",
        "view new --no-browser",
    ),
    (
        "is given twice; leave one out, or compare both: compare LOG --set odom=A,B",
        "replay log.mcap --set odom=off --set odom=auto",
        f"replay log.mcap --set odom=off -o new {FAST}",
        f"compare log.mcap --set odom=auto,off {SHORT} -o new2",
    ),
    (
        "look at it with 'mavnav view', or measure it with 'mavnav metrics'; 'mavnav replay --again' repeats it",
        "replay run",
        "view run --no-browser",
        "metrics run",
        "replay --again run -o new -q",
    ),
    ("batch; look at it with 'mavnav view'", "replay first", "view first --no-browser"),
    ("comparison; look at it with 'mavnav view'", "replay versions", "view versions --no-browser"),
    (
        "is a log; map it with 'mavnav replay log.mcap', and name that run",
        "metrics log.mcap",
        f"replay log.mcap -o measured {SHORT}",
        "metrics measured",
    ),
    (
        "is a merge; compare its map with another by mavnav diff",
        "compare run merged",
        "diff run merged -o new.png --force",
    ),
    (
        "nothing to change; give --crop, --erase, --unknown or --keep-largest",
        "edit run",
        "edit run --crop=-9,-9,9,9 --erase 0,0,1,1 --unknown=-1,-1,0,0 --keep-largest -o new -q",
    ),
    (
        "no trajectory; name one with --trajectory, or a program with --external",
        "score log.mcap",
        "score log.mcap --trajectory run -o new -q",
        "score log.mcap --external 'copy=cp run/trajectory.tum {out}' -o programs -q",
    ),
    (
        "names no directory; write NAME=FILE with a plain name",
        "score log.mcap --trajectory ../a=run",
        "score log.mcap --trajectory a=run -o new -q",
    ),
    (
        "the log has no mounting of the laser; give it with --extrinsic x,y,yaw",
        "score bare.mcap --trajectory run/trajectory.tum,base",
        "score bare.mcap --trajectory run/trajectory.tum,base --extrinsic 0,0,0 -o new -q",
    ),
    (
        "of other runs; choose another directory with -o, or --force to replace it",
        "score log.mcap --trajectory run -o versions",
        "score log.mcap --trajectory run -o versions --force -q",
    ),
    (
        "paper.cell_mm has no effect with the method robust; leave it out, or choose --method paper",
        "compare log.mcap --set paper.cell_mm=20,30",
        "compare log.mcap --method paper --set paper.cell_mm=20,30 --end 0.6 --grid 5x5 -o new -q",
    ),
    (
        "edited was edited, and its numbers are of the map before; measure it with mavnav metrics",
        "compare run edited",
        "metrics run edited -q",
    ),
    (
        "cannot be split into words",
        'score log.mcap --external "a=cp \'x {log} {out}"',
        "score log.mcap --external 'a=cp run/trajectory.tum {out}' -o new -q",
    ),
    (
        "the command has no {out}, the trajectory that it writes; add it",
        "score log.mcap --external 'a=cp run/trajectory.tum'",
        "score log.mcap --external 'a=cp run/trajectory.tum {out}' -o new -q",
    ),
    (
        "names no directory; write NAME='command {log} {out}'",
        "score log.mcap --external '../a=cp run/trajectory.tum {out}'",
        "score log.mcap --external 'a=cp run/trajectory.tum {out}' -o new -q",
    ),
]
