"""Settings of unknown buffers: what is written is read, what is wrong is said, and numbers mean what the page says."""

import contextlib
import json
import random
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from framecast.clip import Record
from framecast.exr import ClipError
from framecast.frame import SKY, perspective
from framecast.importers.decode import (
    decode,
    decode_color,
    decode_depth,
    decode_motion,
    decode_normal,
    decode_scalar,
    jitter_pixels,
    unpack,
)
from framecast.importers.encode import (
    encode,
    encode_color,
    encode_depth,
    encode_jitter,
    encode_motion,
    encode_normal,
    encode_scalar,
    pack,
)
from framecast.importers.listing import Listing
from framecast.importers.settings import (
    Color,
    Depth,
    Jitter,
    Motion,
    Normal,
    Scalar,
    Settings,
    parsed,
    plain,
    read_settings,
    write_settings,
)

AT: dict[str, Any] = {"files": ("{frame}.exr",)}
XY = {**AT, "channels": ("X", "Y")}
H, W = 6, 10
PAGE = Path(__file__).parents[1] / "docs" / "importers.md"
fast = settings(max_examples=25, deadline=None)

signs = st.sampled_from((1.0, -1.0))
factor = st.sampled_from((0.5, 1.0, 2.0, -1.0, 1 / 0.2495))


def rows(matrix: torch.Tensor) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in matrix.double())


LENS = rows(perspective(0.9, W / H))


# Strategies draw JSON: the run-time type checker of our classes must not run while they draw.


@st.composite
def motions(draw: Any, directions: tuple[str, ...] = ("current->previous", "previous->current")) -> dict[str, Any]:
    packed = draw(st.sampled_from(("none", "none", "base255", "base256", "unreal_sqrt")))
    common = {
        **AT,
        "units": draw(st.sampled_from(("pixels", "uv", "ndc"))),
        "sign": [draw(signs), draw(signs)],
        "direction": draw(st.sampled_from(directions)),
        "jittered": draw(st.booleans()),
        "packing": packed,
    }
    if packed.startswith("base"):
        unit = {"pixels": 80.0, "uv": 16.0, "ndc": 32.0}[common["units"]]  # 0..1 has to reach
        return {**common, "channels": list("abcdefgh"), "scale": [unit, unit], "bias": [0.5, 0.5]}
    size = draw(st.sampled_from((None, [W * 2, H * 2])))
    bias = [draw(st.sampled_from((0.0, 0.5))), 0.0]
    return {**common, "channels": ["X", "Y"], "scale": [draw(factor), draw(factor)], "bias": bias, "size": size}


@st.composite
def depths(draw: Any) -> dict[str, Any]:
    kind = draw(st.sampled_from(("planar", "euclidean", "device", "reversed", "inverse", "unit")))
    far = 500.0 if kind == "unit" else draw(st.sampled_from((None, 500.0)))
    near = draw(st.sampled_from((0.05, 0.5)))
    return {**AT, "channels": "Z", "kind": kind, "near": near, "far": far, "scale": draw(factor)}


@st.composite
def whole(draw: Any) -> dict[str, Any]:
    normal = {
        **AT,
        "channels": ["NX", "NY", "NZ"],
        "space": draw(st.sampled_from(("world", "view"))),
        "encoded": draw(st.booleans()),
        "sign": [draw(signs), draw(signs), draw(signs)],
    }
    jitters = ({}, {"halton": 8, "sign": [-1.0, 1.0]}, {"values": [[0.25, -0.5]]})
    return {
        "fps": draw(st.sampled_from((None, 23.976, 60.0))),
        "bottom_up": draw(st.booleans()),
        "color": {**AT, "channels": ["R", "G", "B"], "encoding": draw(st.sampled_from(("linear", "srgb")))},
        "depth": draw(depths()),
        "motion": draw(motions()),
        "motion_next": draw(st.none() | motions(("current->next", "next->current"))),
        "normal": normal,
        "roughness": {**AT, "channels": "r", "scale": -1.0, "bias": 1.0},
        "object": draw(st.none() | st.just({**AT, "channels": "id", "scale": 255.0})),
        "jitter": draw(st.sampled_from(jitters)),
        "cameras": draw(st.sampled_from((None, {"fov": 50.0}, {"file": "cameras.json"}))),
        "axes": draw(st.sampled_from(("opengl", "unreal", "unity", "directx"))),
    }


def fields() -> dict[str, np.ndarray]:
    """One frame of everything, the sky in its first row."""
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(3, H, W))
    normal /= np.linalg.norm(normal, axis=0)
    depth = rng.uniform(1, 300, (1, H, W)).astype(np.float32)
    depth[:, 0], normal[:, 0] = SKY, 0
    return {
        "color": rng.random((3, H, W), np.float32),
        "depth": depth,
        "motion": rng.uniform(-30, 30, (2, H, W)).astype(np.float32),
        "motion_next": rng.uniform(-30, 30, (2, H, W)).astype(np.float32),
        "normal": normal.astype(np.float32),
        "roughness": rng.random((1, H, W), np.float32),
        "object": rng.integers(0, 5, (1, H, W)).astype(np.uint32),
    }


def view(angle: float = 0.3) -> tuple[tuple[float, ...], ...]:
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return ((c, 0.0, s, 0.5), (0.0, 1.0, 0.0, -1.0), (-s, 0.0, c, -4.0), (0.0, 0.0, 0.0, 1.0))


# The file.


@fast
@given(whole())
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, about: dict[str, Any]) -> None:
    made = parsed(about)
    folder = tmp_path_factory.getbasetemp()
    path = write_settings(made, folder)
    assert read_settings(folder) == made
    assert path.name == "framecast-import.json"
    assert not [p for p in folder.iterdir() if ".part" in p.name]


def test_only_what_differs_from_a_frame_is_written() -> None:
    made = Settings(motion=Motion(**XY, sign=(1.0, -1.0)))
    assert plain(made) == {
        "version": 1,
        "source": "generic",
        "motion": {"files": ["{frame}.exr"], "channels": ["X", "Y"], "sign": [1.0, -1.0]},
    }


def test_the_page_holds_settings_that_are_read_and_a_source_that_works(tmp_path: Path) -> None:
    blocks = re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text(), re.DOTALL)
    about = next(json.loads(text) for kind, text in blocks if kind == "json" and '"motion"' in text)
    assert parsed(about).jitter == Jitter(halton=8, sign=(-1.0, -1.0))
    example: dict[str, Any] = {}
    exec(next(text for kind, text in blocks if kind == "python"), example)
    for name in ("color", "mvec", "linearZ"):
        (tmp_path / f"{name}.0001.exr").touch()
    found = example["recognise"](Listing(tmp_path))
    assert found.settings.motion.units == "uv"
    assert example["recognise"](Listing(tmp_path.parent)) is None


def test_a_single_name_needs_no_brackets() -> None:
    made = parsed({"depth": {"files": "{frame}.exr", "channels": "Z"}})
    assert made.depth == Depth(files=("{frame}.exr",), channels=("Z",))


MOTION = {"files": "{frame}.exr", "channels": ["X", "Y"]}
DEPTH = {"files": "{frame}.exr", "channels": "Z"}
WRONG: list[tuple[Any, str]] = [
    ([], r"the file is \[\]; it has to be an object"),
    ({}, "no buffer is told of"),
    ({"colour": DEPTH}, "colour is not known; did you mean color"),
    ({"motion": {**MOTION, "unit": "uv"}}, "motion.unit is not known; did you mean units"),
    ({"motion": {"files": "{frame}.exr"}}, "motion lacks channels"),
    ({"motion": 3}, "motion is 3; it has to be an object"),
    ({"motion": {**MOTION, "units": "pixel"}}, 'motion.units is "pixel"; it may be pixels, uv, ndc'),
    ({"motion": {**MOTION, "units": []}}, r"motion.units is \[\]; it may be"),
    ({"motion": {**MOTION, "sign": [1, 2]}}, "each has to be 1 or -1"),
    ({"motion": {**MOTION, "sign": [1]}}, "has to be a list of 2 values"),
    ({"motion": {**MOTION, "scale": [0, 1]}}, "every vector would be lost"),
    ({"motion": {**MOTION, "jittered": 1}}, "motion.jittered is 1; it has to be true or false"),
    ({"motion": {**MOTION, "direction": "current->next"}}, "put such vectors under motion_next"),
    ({"motion_next": MOTION}, "it has to be current->next or next->current"),
    ({"motion": {**MOTION, "channels": ["X", "Y", "Z"]}}, "motion has 3 channels; it needs 2"),
    ({"motion": {**MOTION, "size": [0, 4]}}, "a width and a height of at least 1"),
    ({"motion": {**MOTION, "files": "a.exr"}}, "has to hold {frame} once"),
    ({"motion": {**MOTION, "files": "../{frame}.exr"}}, "a path inside the folder"),
    ({"motion": {**MOTION, "files": "/etc/{frame}.exr"}}, "a path inside the folder"),
    ({"motion": {**MOTION, "files": []}}, "at least one file pattern"),
    ({"motion": MOTION, "cameras": {"file": "../x.json"}}, "a path inside the folder"),
    ({"motion": MOTION, "cameras": {}}, "cameras needs a file or a fov"),
    ({"motion": MOTION, "cameras": {"fov": 190}}, "between 0 and 180 degrees"),
    ({"motion": MOTION, "fps": 0}, "fps is 0; it has to be above 0"),
    ({"motion": MOTION, "fps": float("nan")}, "fps is NaN; it has to be a number"),
    ({"motion": MOTION, "fps": "24"}, 'fps is "24"; it has to be a number'),
    ({"motion": MOTION, "version": 2}, "this framecast reads version 1"),
    ({"motion": MOTION, "version": 1e400}, "version is Infinity; it has to be a whole number"),
    ({"depth": {**DEPTH, "kind": "reversed"}}, "depth.near is missing"),
    ({"depth": {**DEPTH, "kind": "unit"}}, "depth.far is missing"),
    ({"depth": {**DEPTH, "near": 5, "far": 1}}, "far above near"),
    ({"depth": {**DEPTH, "scale": 0}}, "every number would be lost"),
    ({"roughness": {**DEPTH, "scale": 0}}, "every number would be lost"),
    ({"color": {**MOTION, "channels": ["R", "G", "B"], "exposure": 0}}, "one number above 0"),
    ({"motion": MOTION, "jitter": {"halton": -1}}, "jitter takes values"),
]


@pytest.mark.parametrize(("about", "said"), WRONG)
def test_every_wrong_key_and_value_is_said(tmp_path: Path, about: Any, said: str) -> None:
    path = tmp_path / "s.json"
    path.write_text(json.dumps(about))
    with pytest.raises(ClipError, match=said) as caught:
        read_settings(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_missing_or_no_json_is_said(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="does not exist; let framecast doctor write it"):
        read_settings(tmp_path)
    for text in ("{", "\x00\xff", '{"a": 1} x', "[" * 100_000):
        (tmp_path / "s.json").write_bytes(text.encode("latin-1"))
        with pytest.raises(ClipError, match="is not JSON"):
            read_settings(tmp_path / "s.json")


def test_damaged_files_never_raise_anything_else(tmp_path: Path) -> None:
    path, dice = tmp_path / "s.json", random.Random(2)
    text = json.dumps({"motion": MOTION, "depth": {**DEPTH, "kind": "reversed", "near": 1}, "jitter": {"halton": 8}})
    words = ['"motion"', "null", "[]", "{}", "-1", "1e999", "true", '"', ",", "9" * 40, "\\u0000", "}"]
    for _ in range(400):
        place = dice.randrange(len(text))
        damaged = text[:place] + dice.choice(words) + text[place + dice.randrange(8) :]
        path.write_text(damaged)
        with contextlib.suppress(ClipError):
            read_settings(path)


# Round trips: what one convention stores is the frame again.


@fast
@given(whole())
def test_encoded_and_decoded_is_the_frame_again(about: dict[str, Any]) -> None:
    made = parsed(about)
    here = Record(number=1, time=1.0, jitter=(0.25, -0.125), view=view(), projection=LENS)
    before = Record(number=0, time=0.0, jitter=(-0.375, 0.5))
    after = Record(number=2, time=2.0, jitter=(0.5, 0.0))
    wanted = fields()
    found = decode(encode(wanted, made, here, before, after), made, here, before, after)
    assert found.keys() == {name for name in wanted if getattr(made, name) is not None}
    for name, pixels in found.items():
        near = {"depth": 2e-3, "motion": 2e-3, "motion_next": 2e-3}.get(name, 1e-5)
        np.testing.assert_allclose(pixels, wanted[name], rtol=near, atol=near, err_msg=name)


@fast
@given(motions(), st.integers(0, 1000))
def test_vectors_come_back_within_their_precision(about: dict[str, Any], seed: int) -> None:
    motion = parsed({"motion": about}).motion
    assert motion is not None
    wanted = np.random.default_rng(seed).uniform(-30, 30, (2, H, W)).astype(np.float32)
    shift = (0.3, -0.4)
    stored = encode_motion(wanted, motion, shift)
    assert not motion.packing.startswith("base") or (stored.min() >= 0 and stored.max() <= 1)
    np.testing.assert_allclose(decode_motion(stored, motion, (H, W), shift), wanted, atol=2e-4)


@fast
@given(depths())
def test_depth_comes_back_and_the_sky_stays_the_sky(about: dict[str, Any]) -> None:
    depth = parsed({"depth": about}).depth
    assert depth is not None
    wanted = fields()["depth"]
    found = decode_depth(encode_depth(wanted, depth, LENS), depth, LENS)
    assert (found[wanted == SKY] == SKY).all()
    np.testing.assert_allclose(found, wanted, rtol=2e-3)


@pytest.mark.parametrize("packing", ["base255", "base256"])
@pytest.mark.parametrize("digits", [2, 3, 4])
def test_packed_numbers_are_as_fine_as_their_digits(packing: str, digits: int) -> None:
    values = np.random.default_rng(0).random((1, 50, 50))
    stored = pack(values, digits, packing)
    assert np.abs(np.rint(stored * 255) - stored * 255).max() < 1e-4  # whole bytes
    found = unpack(np.rint(stored * 255).astype(np.float32) / 255, 1, packing)
    assert np.abs(found - values).max() <= 1.01 / 255**digits


@fast
@given(st.sampled_from(("linear", "srgb")), st.sampled_from((1.0, -1.0)), st.booleans())
def test_colour_normals_and_numbers_come_back(encoding: Any, sign: float, encoded: bool) -> None:
    given_fields = fields()
    color = Color(**AT, channels=("R", "G", "B"), encoding=encoding)
    np.testing.assert_allclose(
        decode_color(encode_color(given_fields["color"], color), color), given_fields["color"], atol=1e-6
    )
    normal = Normal(**AT, channels=("R", "G", "B"), encoded=encoded, sign=(1.0, sign, 1.0))
    stored = encode_normal(given_fields["normal"], normal, "unreal")
    np.testing.assert_allclose(decode_normal(stored, normal, "unreal"), given_fields["normal"], atol=1e-6)
    scalar = Scalar(**AT, channels=("R",), scale=-0.5, bias=1.0)
    rough = given_fields["roughness"]
    np.testing.assert_allclose(decode_scalar(encode_scalar(rough, scalar), scalar), rough, atol=1e-6)


@fast
@given(st.sampled_from(("pixels", "uv", "ndc")), signs, signs)
def test_jitter_comes_back(units: Any, x: float, y: float) -> None:
    jitter = Jitter(units=units, sign=(x, y))
    there = encode_jitter((0.25, -0.4), jitter, (H, W))
    assert jitter_pixels(there, jitter, (H, W)) == pytest.approx((0.25, -0.4))
