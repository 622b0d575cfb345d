"""`init`: a folder to begin with."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lodpipe.config import presets
from lodpipe.config.schema import schema_text
from lodpipe.core.errors import OutputError
from lodpipe.stage import AnyStage

CONFIG, SCHEMA, README, DROP = "lodpipe.yaml", "lodpipe.schema.json", "README.md", "drop"

_README = f"""# Levels of detail

Put models into `{DROP}/` (GLB, glTF, OBJ, PLY, STL, OFF), then:

    lodpipe run {DROP} -c {CONFIG} -o lods

Each model gets a folder in `lods/`, with a folder for each level and `report.json`. What could not be processed has
a record in `lods/.failed/`. `{CONFIG}` says which levels and which stages; `lodpipe stages` lists what there is,
`lodpipe check {CONFIG}` tells what is wrong with it. `{SCHEMA}` is for editors.
"""


def make_starter(folder: Path, known: Mapping[str, AnyStage]) -> list[Path]:
    """Make `folder` with a commented configuration, its schema, a drop folder and a README; returns what was made.

    Raises OutputError, and makes nothing, where one of them is there already.
    """
    preset = (presets.FOLDER / "default.yaml").read_text(encoding="utf-8")
    files = {
        CONFIG: f"# yaml-language-server: $schema={SCHEMA}\n{preset}",
        SCHEMA: schema_text(known),
        README: _README,
    }
    taken = [name for name in (*files, DROP) if (folder / name).exists()]
    if taken:
        raise OutputError(f"is there already ({', '.join(taken)})", place=str(folder), advice="choose another folder")
    try:
        (folder / DROP).mkdir(parents=True)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot be written ({error.strerror})", place=str(folder)) from error
    return [*(folder / name for name in files), folder / DROP]
