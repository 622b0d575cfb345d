from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import model_files as files
from lodpipe import io
from lodpipe.core.errors import AssetError
from lodpipe.io.meshopt import decode

#: What the encoder of meshoptimizer 1.3.0 (the npm package) made of small arrays, and what its decoder made of that:
#: name, mode, filter, count, stride, compressed, decompressed.
STREAMS = [
    (
        "ramp0",
        "ATTRIBUTES",
        "NONE",
        19,
        8,
        (
            "oAcAHhYaGAgoCBokFhoKIhwU/AAAABgcFgAHANY1cZJknWOEngVedN9yifwAAADfcjsGCG8y82/ishEPEA/wAAAABAQHABgQ"
            "GhweGBQQGCYWDhoiEvwAAAAUGhgAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAFAIQDCgAAAA=="
        ),
        (
            "BQCEAwoAAAAUAO8HFgAAAB8A1AoeAAAALACbAisAAAA4AOQAOQAAADwAFgFIAAAAUADHCVQAAABUAJUHXgAAAGEA1wpmAAAA"
            "cwAmAnIAAAB+ACMJhQAAAIsAUgqQAAAAkACMBJcAAAChABwFpAAAAK8AVQS1AAAAuQAQA74AAADFAKAFyAAAANMA2QfVAAAA"
            "3gC7B+EAAAA="
        ),
    ),
    (
        "float0",
        "ATTRIBUTES",
        "NONE",
        19,
        4,
        "oAAABwAA/4CAQEBAQCAgICAgICD8AAAAIBAQBTCAAAB8gAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA",
        ("AAAAAAAAAD4AAIA+AADAPgAAAD8AACA/AABAPwAAYD8AAIA/AACQPwAAoD8AALA/AADAPwAA0D8AAOA/AADwPwAAAEAAAAhAAAAQQA=="),
    ),
    (
        "ramp1",
        "ATTRIBUTES",
        "NONE",
        19,
        8,
        (
            "oXurABgSIBoaDhYUJBQeCiAUIBIWJADWYEB/Oe8zOmkVxgNXy48a8YECCBWniSQw7yIPBwADCgQAIBAaIBYcFhoSFh4aGhIQ"
            "KBIeAAAAAAAAAAAAAAAAAAAFAMsCBgAAAAAA"
        ),
        (
            "BQDLAgYAAAARADYGFgAAABoAZgUeAAAAKgCGAisAAAA3AEYHOwAAAEQAKQNGAAAASwCxB1QAAABWAJcCXwAAAGAAtANsAAAA"
            "cgB/BXUAAAB8AHQDgAAAAIsA1wOPAAAAkADVCpwAAACgAKkCqQAAAKoAQwOyAAAAugD7BLoAAADDAAgCzgAAAM4AjwfXAAAA"
            "4ABOCeYAAAA="
        ),
    ),
    (
        "float1",
        "ATTRIBUTES",
        "NONE",
        19,
        4,
        "oToAAACAgEBAQEAgICAgICAgIBAQAQYAfAEAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAE=",
        ("AAAAAAAAAD4AAIA+AADAPgAAAD8AACA/AABAPwAAYD8AAIA/AACQPwAAoD8AALA/AADAPwAA0D8AAOA/AADwPwAAAEAAAAhAAAAQQA=="),
    ),
    (
        "noise1",
        "ATTRIBUTES",
        "NONE",
        5,
        4,
        "of8A74/EBgCO0ufSAObkGU8AxmNS/wAAAAAAAAAAAAAAAAAAAAAAAABBOn5kAA==",
        "QTp+ZMmB8ceB6mOV43ZWvubfLj4=",
    ),
    (
        "normal8",
        "ATTRIBUTES",
        "OCTAHEDRAL",
        4,
        4,
        "oAE/AAAAbOpXAT8AAACRF6oAATwAAAAEAwAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAH9/",
        "AAB/f0yaAIG3t7Z/fwAAfw==",
    ),
    (
        "normal16",
        "ATTRIBUTES",
        "OCTAHEDRAL",
        4,
        8,
        ("oAE/AAAA2nyoAT8AAAAGERoBPwAAANx6qgE3AAAACQwAAAE8AAAABAMBJAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAD/B/9/"),
        "AAAAAP9//3/FTJWZAAABgCO2I7YHtv9//38AAAAA/38=",
    ),
    (
        "turn",
        "ATTRIBUTES",
        "QUATERNION",
        4,
        8,
        (
            "oAE/AAAAsYXHAT8AAAAKAwUBPwAAALKGxgE/AAAACwQWAT8AAACx9EEBPQAAAAoHATkAAAAFAAAAAAAAAAAAAAAAAAAAAAAA"
            "AAAAAAAAAAAAAAAAAP8H"
        ),
        "AAAAAAAA/38PQPo/BsD6P8cMNnNhJp/ZgloAAIJaAAA=",
    ),
    (
        "wide",
        "ATTRIBUTES",
        "EXPONENTIAL",
        4,
        8,
        (
            "oAE/AAAA8O+AAT8AAAAEBwoAAT4AAAA2LwEPAAAAgL8BPwAAAAoICQEhAAAAAT4AAAA2LwAAAAAAAAAAAAAAAAAAAAAAAAAA"
            "AAAAAAACAPcA+//3"
        ),
        "AACAPwAAIMAAAI9NAAAAAAAAAAAAAIhBAAAoQgAAgL8=",
    ),
    (
        "colour",
        "ATTRIBUTES",
        "COLOR",
        4,
        4,
        "of8AvnHNAIIaZgDDvQAA/cwyAAAAAAAAAAAAAAAAAAAAAAAAAEB/wf8A",
        "/gEA/wD+gAAzZpnM/////w==",
    ),
    (
        "tri",
        "TRIANGLES",
        "NONE",
        63,
        4,
        "4f4eEA4QDo4eFA4TDo4eEw4TDv///w8Ir8oH+L0I/9vFCAEB/yACAgB2h1ZneKmGZYlomAFpAAA=",
        (
            "AAAAAAEAAAAEAAAABAAAAAEAAAAFAAAABQAAAAEAAAACAAAABQAAAAIAAAAGAAAABgAAAAIAAAADAAAABgAAAAMAAAAHAAAA"
            "BAAAAAUAAAAIAAAACAAAAAUAAAAJAAAACQAAAAUAAAAGAAAACQAAAAYAAAAKAAAACgAAAAYAAAAHAAAACgAAAAcAAAALAAAA"
            "CAAAAAkAAAAMAAAADAAAAAkAAAANAAAADQAAAAkAAAAKAAAADQAAAAoAAAAOAAAADgAAAAoAAAALAAAADgAAAAsAAAAPAAAA"
            "9AEAAAMAAABwEQEAAgAAAAEAAAAAAAAAEAAAABEAAAASAAAA"
        ),
    ),
    (
        "tri16",
        "TRIANGLES",
        "NONE",
        54,
        2,
        "4f4eEA4QDo4eFA4TDo4eEw4TDg8IAHaHVmd4qYZliWiYAWkAAA==",
        (
            "AAABAAQABAABAAUABQABAAIABQACAAYABgACAAMABgADAAcABAAFAAgACAAFAAkACQAFAAYACQAGAAoACgAGAAcACgAHAAsA"
            "CAAJAAwADAAJAA0ADQAJAAoADQAKAA4ADgAKAAsADgALAA8A"
        ),
    ),
    (
        "idx",
        "INDICES",
        "NONE",
        63,
        4,
        "0QAEDAoQAgoEDAoQAgoEDAoQAgYEDAoQAgoEDAoQAgoEDAoQAgYEDAoQAgoEDAoQAgoEDAoQAtEPKvH7EAICAkAEBAAAAAA=",
        (
            "AAAAAAEAAAAEAAAAAQAAAAUAAAAEAAAAAQAAAAIAAAAFAAAAAgAAAAYAAAAFAAAAAgAAAAMAAAAGAAAAAwAAAAcAAAAGAAAA"
            "BAAAAAUAAAAIAAAABQAAAAkAAAAIAAAABQAAAAYAAAAJAAAABgAAAAoAAAAJAAAABgAAAAcAAAAKAAAABwAAAAsAAAAKAAAA"
            "CAAAAAkAAAAMAAAACQAAAA0AAAAMAAAACQAAAAoAAAANAAAACgAAAA4AAAANAAAACgAAAAsAAAAOAAAACwAAAA8AAAAOAAAA"
            "9AEAAAMAAABwEQEAAgAAAAEAAAAAAAAAEAAAABEAAAASAAAA"
        ),
    ),
    (
        "rotated0",
        "ATTRIBUTES",
        "NONE",
        18,
        4,
        "oZoCD6jeHzPwYBoPDw8DAA4MAAAAAAAAAAAAAAAAAAAAAAAAAFOsUUcC",
        "U6xRR1OsXkdTrFRHU6xcR1OsUUdTrF9HU6xeR1OsUUdTrFJHU6xRR1OsXkdTrF5HU6xYR1OsWEdTrFlHU6xTR1OsXUdTrFFH",
    ),
    (
        "rotated5",
        "ATTRIBUTES",
        "NONE",
        18,
        4,
        "oakCAbagABcPUjUPAwAHCAAAAAAAAAAAAAAAAAAAAAAAAAAgBFoBUg==",
        "IARaASAEWgkgBFpRIARaYSAEWjEgBFoxIARaMSAEWjEgBFo5IARaASAEWgEgBFp5IARaUSAEWkEgBFpZIARacSAEWkkgBFoJ",
    ),
]
BY_NAME = {row[0]: row for row in STREAMS}


@pytest.mark.parametrize(("name", "mode", "method", "count", "stride", "packed", "plain"), STREAMS)
def test_streams_of_the_reference_encoder(
    name: str, mode: str, method: str, count: int, stride: int, packed: str, plain: str
) -> None:
    found = decode(base64.b64decode(packed), mode, method, count, stride)
    want = np.frombuffer(base64.b64decode(plain), np.uint8)
    if method in ("NONE", "EXPONENTIAL"):
        assert np.array_equal(found, want)
    else:  # the extension allows the other filters one unit in the last place
        kind = np.dtype(f"<{'u' if method == 'COLOR' else 'i'}{stride // 4}")
        assert np.abs(found.view(kind).astype(int) - want.view(kind)).max() <= 1


def test_the_example_of_the_specification() -> None:
    """Sixteen deltas of four bits with two sentinels (EXT_meshopt_compression, appendix A, mode 0)."""
    group = bytes.fromhex("175ff0bc77a92100 34b5")
    deltas = [-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0]
    stream = b"\xa0" + b"\2" + group + bytes(3) + bytes(32)
    found = decode(stream, "ATTRIBUTES", "NONE", 16, 4).reshape(16, 4)
    assert found[:, 0].tolist() == [v % 256 for v in np.cumsum(deltas).tolist()]
    assert not found[:, 1:].any()


@given(st.sampled_from(STREAMS), st.data())
def test_damaged_streams_end_in_an_error_or_in_an_array(
    row: tuple[str, str, str, int, int, str, str], data: st.DataObject
) -> None:
    _, mode, method, count, stride, packed, _ = row
    stream = bytearray(base64.b64decode(packed))
    for _ in range(data.draw(st.integers(1, 4))):
        stream[data.draw(st.integers(0, len(stream) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(stream)))
    try:
        assert len(decode(bytes(stream[:cut]), mode, method, count, stride)) == count * stride
    except AssetError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("mode", "method", "stride", "message"),
    [
        ("ATTRIBUTES", "NONE", 6, "byteStride 6"),
        ("ATTRIBUTES", "SPHERICAL", 8, "filter 'SPHERICAL'"),
        ("TRIANGLES", "NONE", 3, "byteStride 3"),
        ("WAVELETS", "NONE", 4, "mode 'WAVELETS'"),
        ("INDICES", "NONE", 4, "unknown header"),
        ("TRIANGLES", "NONE", 4, "unknown header"),
    ],
)
def test_what_is_not_in_the_specification(mode: str, method: str, stride: int, message: str) -> None:
    with pytest.raises(AssetError, match=message):
        decode(base64.b64decode(BY_NAME["ramp0"][5]), mode, method, 19, stride)


def test_a_compressed_model(tmp_path: Path) -> None:
    g = files.Gltf()
    _, _, _, count, stride, _, plain = BY_NAME["ramp0"]
    views = []
    for name in ("ramp0", "tri16"):
        _, mode, method, elements, size, stream, _ = BY_NAME[name]
        said = {"buffer": 0, "byteOffset": len(g.data), "byteStride": size, "count": elements, "mode": mode}
        raw = base64.b64decode(stream)
        g.data += raw
        extension = {**said, "byteLength": len(raw), "filter": method}
        views.append({"buffer": 1, "byteLength": elements * size, "extensions": {"EXT_meshopt_compression": extension}})
    views[0]["byteStride"] = stride
    g.tree["bufferViews"] = views
    g.tree["accessors"] = [
        {"bufferView": 0, "componentType": 5123, "type": "VEC3", "count": count},
        {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": 54},
    ]
    g.mesh({"attributes": {"POSITION": 0}, "indices": 1})
    g.tree["extensionsRequired"] = ["EXT_meshopt_compression", "KHR_mesh_quantization"]
    path = g.save(tmp_path / "m.glb")
    fallback = {"byteLength": 1000, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}
    g.tree["buffers"].append(fallback)
    path.write_bytes(files.glb(json.dumps(g.tree).encode(), g.data))
    mesh = io.load(path).meshes[0]
    points = np.frombuffer(base64.b64decode(plain), np.uint16).reshape(-1, 4)[:, :3]
    order = np.frombuffer(base64.b64decode(BY_NAME["tri16"][6]), np.uint16).reshape(-1, 3)
    assert mesh.positions[mesh.faces].tolist() == points[order].tolist()
    views[0]["extensions"]["EXT_meshopt_compression"]["count"] = 99
    path.write_bytes(files.glb(json.dumps(g.tree).encode(), g.data))
    with pytest.raises(AssetError, match=r"bufferViews\[0\].extensions.EXT_meshopt_compression: 99 elements"):
        io.load(path)
