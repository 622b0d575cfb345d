"""The command line: arguments in, exit code out. Everything heavy is imported by the command that needs it.

Exit codes: 0 all fine, 1 an error of the user's or the asset's (the other assets are still processed), 2 wrong usage,
3 a bug, 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from lodpipe.core.errors import LodpipeError

TRACEBACK = "LODPIPE_TRACEBACK"
"""Environment variable: set, a bug shows its traceback."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):  # replaced by something that is not a text file
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]  # names may be in any encoding
    options = _parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    try:
        return command(options)
    except LodpipeError as error:
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever reads has had enough: `lodpipe stages | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:  # the one place where a bug becomes an exit code
        print(f"error: internal error: {type(error).__name__}: {error}", file=sys.stderr)
        if os.environ.get(TRACEBACK):
            traceback.print_exc()
        else:
            print(f"this is a bug, please report it; {TRACEBACK}=1 shows where it is", file=sys.stderr)
        return 3


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="lodpipe",
        description="Textured 3-D models in, folders of levels of detail (LODs) and a report out.",
        epilog="Begin with: lodpipe run model.glb -o out",
    )
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    run = commands.add_parser("run", help="make levels of detail of files, folders or globs", description=_RUN)
    run.add_argument(
        "assets", nargs="+", metavar="ASSET", help="a file, a folder (with all below it), or a quoted glob"
    )
    _config_arguments(run, flag=True)
    run.add_argument("-o", "--output", default="out", metavar="OUT", help="output folder (default: %(default)s)")
    run.add_argument("--workers", type=_count, default=1, metavar="N", help="assets at a time (default: %(default)s)")
    run.add_argument("--force", action="store_true", help="also what is up to date already")
    run.add_argument("-q", "--quiet", action="store_true", help="nothing but errors")
    run.add_argument("--json", action="store_true", help="one JSON document on stdout, when all is done")
    run.set_defaults(command=_run)

    watch = commands.add_parser("watch", help="do the same for whatever turns up in a folder", description=_WATCH)
    watch.add_argument("drop", metavar="DROP", help="the folder to watch, with all below it")
    _config_arguments(watch, flag=True)
    watch.add_argument("-o", "--output", default="out", metavar="OUT", help="output folder (default: %(default)s)")
    watch.add_argument("--once", action="store_true", help="do what is there, then end (exit code 1 if some failed)")
    watch.add_argument(
        "--poll", type=float, metavar="S", help="look at the folder every S seconds, without file events"
    )
    watch.add_argument("--workers", type=_count, metavar="N", help="assets at a time")
    watch.add_argument("--executor", metavar="NAME", help="where jobs run: local, dask, or a plug-in")
    watch.add_argument("--scheduler", metavar="ADDRESS", help="of the executor: tcp://farm:8786")
    watch.add_argument("--port", type=int, metavar="PORT", help="status page, /healthz and /metrics on 127.0.0.1")
    watch.add_argument(
        "--log", choices=("json", "text"), help="form of the log (default: text on a terminal, else json)"
    )
    _state_argument(watch)
    watch.set_defaults(command=_watch)

    status = commands.add_parser("status", help="what the daemon of an output folder does")
    status.add_argument("outputs", nargs="+", metavar="OUT")
    status.add_argument("--all", action="store_true", help="list every asset")
    status.add_argument("--json", action="store_true", help="as JSON, every asset included")
    _state_argument(status)
    status.set_defaults(command=_status)

    retry = commands.add_parser("retry", help="have the daemon try again what failed", description=_RETRY)
    retry.add_argument("output", metavar="OUT")
    retry.add_argument(
        "assets", nargs="*", metavar="ASSET", help="an input, a result or a glob (default: all that failed)"
    )
    retry.add_argument("--force", action="store_true", help="also what is published already")
    _state_argument(retry)
    retry.set_defaults(command=_retry)

    for name, text in (("pause", "have the daemon begin no new jobs"), ("resume", "have the daemon go on")):
        control = commands.add_parser(name, help=text)
        control.add_argument("outputs", nargs="+", metavar="OUT")
        _state_argument(control)
        control.set_defaults(command=_pause if name == "pause" else _resume)

    check = commands.add_parser("check", help="validate a configuration", description="Validate a configuration.")
    _config_arguments(check, flag=False)
    check.add_argument("--resolved", action="store_true", help="print all of it, defaults included")
    check.set_defaults(command=_check)

    stages = commands.add_parser("stages", help="list the stages and their parameters, plug-ins included")
    stages.add_argument("name", nargs="?", metavar="NAME", help="only this stage, with its parameters")
    stages.add_argument("--plugins", action="append", default=[], metavar="DIR", help="folder of plug-in files")
    stages.add_argument("--json", action="store_true", help="as JSON")
    stages.set_defaults(command=_stages)

    schema = commands.add_parser("schema", help="print the JSON Schema of configurations, for editors")
    schema.add_argument("--plugins", action="append", default=[], metavar="DIR", help="folder of plug-in files")
    schema.set_defaults(command=_schema)

    init = commands.add_parser("init", help="make a starter folder", description="Make a starter folder.")
    init.add_argument("folder", metavar="DIR")
    init.set_defaults(command=_init)

    inspect = commands.add_parser("inspect", help="show what is in a model, and what is wrong with it")
    inspect.add_argument("asset", metavar="ASSET")
    inspect.add_argument("--json", action="store_true", help="as JSON, with the field names of gltf-transform")
    inspect.set_defaults(command=_inspect)

    compare = commands.add_parser("compare", help="how different two models look and are", description=_COMPARE)
    compare.add_argument("a", metavar="A", help="the reference, a file of any format that is read")
    compare.add_argument("b", metavar="B", help="what is compared with it: a level of it, or another tool's result")
    compare.add_argument("--views", type=_count, default=12, metavar="N", help="directions (default: %(default)s)")
    compare.add_argument("--size", type=_count, default=512, metavar="PX", help="pixels a side (default: %(default)s)")
    compare.add_argument(
        "--protocol",
        choices=("studio", "papers"),
        default="studio",
        help="lights: as models are looked at, or as papers on simplification measure (default: %(default)s)",
    )
    compare.add_argument("--samples", type=_count, default=100_000, metavar="N", help="points for distances")
    compare.add_argument("--json", action="store_true", help="as JSON")
    compare.add_argument("-o", "--output", metavar="DIR", help="write pairs of pictures and difference maps")
    compare.set_defaults(command=_compare)

    skeleton = commands.add_parser("skeleton", help="find a model's skeleton and segments", description=_SKELETON)
    skeleton.add_argument("asset", metavar="ASSET")
    skeleton.add_argument("--method", choices=("geodesic", "dcg"), default="geodesic", help="default: %(default)s")
    skeleton.add_argument("--json", action="store_true", help="as JSON")
    skeleton.add_argument("-o", "--output", metavar="OUT.glb", help="write the skeleton and coloured segments")
    skeleton.set_defaults(command=_skeleton)
    return parser


_COMPARE = """How different two models look and are: pictures of both from many directions, and the distance between the
surfaces. docs/measuring.md defines the figures."""
_SKELETON = """Find the curve skeleton of a model and the segments along it: ends, joints, loops, for each connected
component. Places are those of the scene; seconds do not count loading."""
_RUN = """Lead assets through the stages of a configuration. OUT/<relative folder>/<asset>/ gets a folder for each
level, report.json and manifest.json; what fails leaves its record in OUT/.failed/."""


_WATCH = """Watch a folder and do for every asset in it what `run` does, as soon as all its files are there and at rest;
again when they change. SIGTERM finishes what runs, a second one does not; SIGHUP reads the configuration again."""
_RETRY = (
    """Ask the daemon for assets once more. Works whether it runs or not: what is asked for is done when it does."""
)


def _state_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--state", metavar="DIR", help="folder of the daemon's job table (default: OUT/.lodpipe)")


def _config_arguments(parser: argparse.ArgumentParser, *, flag: bool) -> None:
    text = "a YAML file, or a preset: default, fast, quality, baked"
    if flag:
        parser.add_argument(
            "-c", "--config", default="default", metavar="CONFIG", help=f"{text} (default: %(default)s)"
        )
    else:
        parser.add_argument("config", metavar="CONFIG", help=text)
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        dest="settings",
        help="put a value over the configuration's: decimate.metric=quadric, lods='[{ratio: 0.1}]', limits.minutes=5",
    )
    parser.add_argument("--plugins", action="append", default=[], metavar="DIR", help="folder of plug-in files")


def _run(options: argparse.Namespace) -> int:
    from lodpipe.reporting.terminal import Display, JsonDisplay
    from lodpipe.service.batch import run
    from lodpipe.service.interrupt import terminable

    display: Display
    if options.json:
        display = JsonDisplay(sys.stdout, sys.stderr)
    else:
        display = Display(sys.stdout, sys.stderr, quiet=options.quiet)
    with terminable(), display:
        batch = run(
            options.assets,
            options.config,
            options.output,
            settings=options.settings,
            plugins=options.plugins,
            workers=options.workers,
            force=options.force,
            listener=display,
        )
    return batch.exit_code


def _watch(options: argparse.Namespace) -> int:
    from lodpipe.service.logs import daemon_log
    from lodpipe.service.watch import Request, watch

    given = {
        "watch.workers": options.workers,
        "watch.executor": options.executor,
        "watch.scheduler": options.scheduler,
        "watch.port": options.port,
        "watch.poll_s": options.poll,
        "watch.events": None if options.poll is None else "'off'",
    }
    settings = [f"{path}={value}" for path, value in given.items() if value is not None]
    request = Request(
        drop=Path(options.drop),
        output=Path(options.output),
        config=options.config,
        settings=(*options.settings, *settings),
        plugins=tuple(options.plugins),
        state=Path(options.state) if options.state else None,
        once=options.once,
    )
    return watch(request, daemon_log(sys.stderr, text=(options.log or ("json", "text")[sys.stderr.isatty()]) == "text"))


def _status(options: argparse.Namespace) -> int:
    from lodpipe.reporting.daemon_status import status_lines
    from lodpipe.reporting.table import Style
    from lodpipe.service.control import status

    found = [status(state, every=options.all or options.json) for state in _states(options)]
    if options.json:
        print(json.dumps(found[0] if len(found) == 1 else found, indent=2))
    else:
        print("\n".join(line for one in found for line in status_lines(one, Style(sys.stdout), every=options.all)))
    return 0


def _retry(options: argparse.Namespace) -> int:
    from lodpipe.service.control import retry, state_folder

    state = state_folder(Path(options.output), Path(options.state) if options.state else None)
    chosen = retry(state, options.assets, force=options.force)
    print("\n".join(chosen) if chosen else "nothing has failed")
    return 0


def _pause(options: argparse.Namespace) -> int:
    from lodpipe.service.control import pause

    for state in _states(options):
        pause(state)
    return 0


def _resume(options: argparse.Namespace) -> int:
    from lodpipe.service.control import resume

    for state in _states(options):
        resume(state)
    return 0


def _states(options: argparse.Namespace) -> list[Path]:
    """The state folders of the output folders that were named."""
    from lodpipe.service.control import state_folder

    if options.state and len(options.outputs) > 1:
        raise LodpipeError("--state goes with one output folder")
    return [state_folder(Path(output), Path(options.state) if options.state else None) for output in options.outputs]


def _check(options: argparse.Namespace) -> int:
    from lodpipe.service.chain import load_chain

    loaded = load_chain(options.config, options.settings, options.plugins)
    if options.resolved:
        from lodpipe.config.source import dump

        print(dump(loaded.pipeline.resolved()), end="")
    else:
        names = " → ".join(step.stage.name for step in loaded.pipeline.steps)
        print(f"{loaded.name}: ok: {len(loaded.pipeline.config.lods)} levels below the source, {names}")
    return 0


def _stages(options: argparse.Namespace) -> int:
    from lodpipe.config.describe import describe_stage
    from lodpipe.config.problems import did_you_mean
    from lodpipe.plugins import find_stages
    from lodpipe.reporting.stage_list import stage_lines, stage_list

    known = find_stages(Path(folder) for folder in options.plugins)
    if options.name is not None and options.name not in known:
        raise LodpipeError(f"unknown stage '{options.name}'{did_you_mean(options.name, known)}")
    listed = [describe_stage(stage) for name, stage in sorted(known.items()) if options.name in (None, name)]
    if options.json:
        print(json.dumps(listed, indent=2))
    else:
        print("\n".join(stage_lines(listed[0]) if options.name else stage_list(listed)))
    return 0


def _schema(options: argparse.Namespace) -> int:
    from lodpipe.config.schema import schema_text
    from lodpipe.plugins import find_stages

    print(schema_text(find_stages(Path(folder) for folder in options.plugins)), end="")
    return 0


def _init(options: argparse.Namespace) -> int:
    from lodpipe.config.starter import make_starter
    from lodpipe.plugins import find_stages

    for path in make_starter(Path(options.folder), find_stages()):
        print(path)
    return 0


def _inspect(options: argparse.Namespace) -> int:
    import dataclasses

    from lodpipe import io
    from lodpipe.geometry.topology import topology_defects
    from lodpipe.geometry.uv_defects import texture_sizes, uv_defects
    from lodpipe.reporting.inspection import inspection, inspection_json, inspection_text

    asset = io.load(Path(options.asset))
    topology = [dataclasses.asdict(topology_defects(mesh)) for mesh in asset.meshes]
    sizes = texture_sizes(asset)
    uv = [[dataclasses.asdict(entry) for entry in uv_defects(mesh, sizes)] for mesh in asset.meshes]
    data = inspection(asset, topology, uv)
    print(inspection_json(data) if options.json else "\n".join(inspection_text(data)))
    return 0


def _compare(options: argparse.Namespace) -> int:
    from lodpipe import io
    from lodpipe.geometry.compare import compare_models, galleries, pictures
    from lodpipe.geometry.pictures import setup_named
    from lodpipe.geometry.sheet import png_bytes
    from lodpipe.geometry.texture import Textures
    from lodpipe.io.writing import write_files
    from lodpipe.reporting.comparison import comparison_data, comparison_text, dump_json
    from lodpipe.reporting.table import Style

    paths = (options.a, options.b)
    assets = [io.load(Path(path)) for path in paths]
    setup = setup_named(options.protocol, options.views, options.size)
    warnings = [text for asset in assets for text in asset.warnings]
    a, b = (Textures(io.pixels_of(asset, warnings.append), setup.lighting.linear) for asset in assets)
    first, second = galleries(assets[0], assets[1], (a, b), setup)
    figures = compare_models(first, second, samples=options.samples).data()
    named = [(path, asset.triangles, asset.vertices) for path, asset in zip(paths, assets, strict=True)]
    if options.output:
        images = ((f"{name}.png", png_bytes(image)) for name, image in pictures(first, second))
        figures["files"] = [str(path) for path in write_files(Path(options.output), images)]
    data = comparison_data(named, figures, warnings)
    print(dump_json(data) if options.json else "\n".join(comparison_text(data, Style(sys.stdout))))
    return 0


def _skeleton(options: argparse.Namespace) -> int:
    import time

    from lodpipe import io
    from lodpipe.geometry.segment import segment
    from lodpipe.geometry.skeleton import SkeletonOptions, load_libraries, skeleton
    from lodpipe.geometry.skeleton_view import skeleton_model
    from lodpipe.reporting.skeleton import skeleton_data, skeleton_text

    asset = io.load(Path(options.asset))
    load_libraries()
    begin = time.perf_counter()
    found = skeleton(asset, SkeletonOptions(method=options.method))
    segments = segment(asset, found)
    data = skeleton_data(found, segments, time.perf_counter() - begin)
    if options.output:
        io.save(skeleton_model(asset, found, segments), Path(options.output))
    print(json.dumps(data, indent=1) if options.json else "\n".join(skeleton_text(data)))
    return 0


def _count(text: str) -> int:
    value = int(text) if text.isdecimal() else 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number of at least 1")
    return value


class _Version(argparse.Action):
    """Prints the version, which is looked up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, default=argparse.SUPPRESS, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *rest: object) -> None:
        import lodpipe

        print(f"lodpipe {lodpipe.__version__}")
        parser.exit()
