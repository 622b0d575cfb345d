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
    return parser


_RUN = """Lead assets through the stages of a configuration. OUT/<relative folder>/<asset>/ gets a folder for each
level, report.json and manifest.json; what fails leaves its record in OUT/.failed/."""


def _config_arguments(parser: argparse.ArgumentParser, *, flag: bool) -> None:
    text = "a YAML file, or a preset: default, fast"
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
