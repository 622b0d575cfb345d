"""Agreement with an independent implementation of the protocol `papers`: other rays, other shading code, other metrics.

It needs the benchmark's environment (`LODPIPE_BENCH`) and the judge and models that lie beside the repository.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

import lodpipe
from lodpipe.core.asset import Target
from lodpipe.geometry.compare import compare_pictures, galleries
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.pictures import setup_named
from lodpipe.geometry.texture import Textures
from lodpipe.io import pixels_of

SHARED = Path(__file__).parents[3] / "shared"
PYTHON = Path(os.environ.get("LODPIPE_BENCH", "/opt/bench")) / "peers" / "bin" / "python"
MODELS = ("duck.glb", "spot_cow/cow.obj", "flight_helmet/FlightHelmet.gltf", "barrel.glb", "oculus_touch_left.glb")
JUDGE = """
import json, sys
sys.path.insert(0, sys.argv[1])
from judge import Judge
from mesh import load
if __name__ == "__main__":
    judge = Judge(load(sys.argv[2]))
    print(json.dumps([judge(load(path)) for path in sys.argv[3:]]))
    judge.close()
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_luminance_and_silhouettes_agree_within_two_percent(tmp_path, name):
    """Two levels of each of five textured models: ten pairs."""
    if not (SHARED / "bench" / "judge.py").exists() or not PYTHON.exists():
        pytest.skip("the independent judge is not installed here")
    path = SHARED / "assets" / "dev" / name
    asset = lodpipe.load(path)
    levels = decimate_asset(asset, [Target(ratio=0.3), Target(ratio=0.1)])[1:]
    files = [tmp_path / f"level{number}.glb" for number in range(len(levels))]
    for file, level in zip(files, levels, strict=True):
        lodpipe.save(asset, file, level.meshes)
    (tmp_path / "run.py").write_text(JUDGE)
    command = [str(PYTHON), str(tmp_path / "run.py"), str(SHARED / "bench"), str(path), *map(str, files)]
    judged = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    for file, theirs in zip(files, judged, strict=True):
        other = lodpipe.load(file)
        textures = tuple(Textures(pixels_of(x), srgb=False) for x in (asset, other))
        ours = compare_pictures(*galleries(asset, other, textures, setup_named("papers", 24, 512)))
        assert ours.luminance_rms == pytest.approx(theirs["tex"]["rms"], rel=0.02)
        assert 1 - ours.silhouette_iou == pytest.approx(theirs["iou"] / 100, rel=0.02, abs=1e-5)
        assert ours.psnr == pytest.approx(theirs["tex"]["psnr"], abs=0.2)
        assert ours.ssim == pytest.approx(theirs["tex"]["ssim"], abs=0.01)
        assert ours.normal_degrees == pytest.approx(theirs["ndeg"], rel=0.02)
