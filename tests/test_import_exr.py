"""EXR and picture files of every kind, and hostile ones: read exactly, or refused in a sentence, in bounded memory."""

import random
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from PIL import Image

from framecast import exr
from framecast.exr import ClipError
from framecast.importers import images

H, W = 13, 21
LOSSY = {"B44": 0.2, "B44A": 0.2, "DWAA": 0.02, "DWAB": 0.02, "PXR24": 1e-4}
KINDS = [n.removesuffix("_COMPRESSION") for n in dir(OpenEXR) if n.endswith("_COMPRESSION") and not n.startswith("NUM")]


def planes() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    y = np.linspace(0, 1, H * W).reshape(H, W)
    return {
        "R": y.astype(np.float16),
        "Depth.Z": rng.random((H, W), np.float32),
        "Id.Y": rng.integers(0, 2**31, (H, W)).astype(np.uint32),
    }


def header(kind: str, tiled: bool = False) -> dict[str, object]:
    about = {"compression": getattr(OpenEXR, f"{kind}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    if tiled:
        tile = OpenEXR.TileDescription()
        tile.xSize, tile.ySize = 8, 8
        about |= {"type": OpenEXR.tiledimage, "tiles": tile}
    return about


@pytest.mark.parametrize("tiled", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_every_compression(tmp_path: Path, kind: str, tiled: bool) -> None:
    path, wanted = tmp_path / "a.exr", planes()
    OpenEXR.File(header(kind, tiled), dict(planes())).write(str(path))
    found = exr.read(path)
    assert exr.header(path).names == tuple(found.channels) == tuple(sorted(wanted))
    for name, pixels in wanted.items():
        assert found.channels[name].dtype == pixels.dtype
        near = 0 if name == "Id.Y" else LOSSY.get(kind, 0)
        np.testing.assert_allclose(found.channels[name].astype(float), pixels.astype(float), atol=near)


def test_parts_that_share_names_are_told_apart(tmp_path: Path) -> None:
    parts = [
        OpenEXR.Part({"name": "Depth", "type": OpenEXR.scanlineimage}, {"R": np.full((H, W), 2, np.float32)}),
        OpenEXR.Part(
            {"name": "Beauty", "type": OpenEXR.scanlineimage}, {c: np.full((H, W), 1, np.float16) for c in "RGB"}
        ),
        OpenEXR.Part({"name": "Own", "type": OpenEXR.scanlineimage}, {"Z": np.full((H, W), 3, np.float32)}),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    names = ("Depth.R", "Beauty.B", "Beauty.G", "Beauty.R", "Z")
    assert exr.header(tmp_path / "a.exr").names == names
    found = exr.read(tmp_path / "a.exr").channels
    assert {name: float(pixels.max()) for name, pixels in found.items()} == dict(
        zip(names, (2, 1, 1, 1, 3), strict=True)
    )


def test_a_data_window_that_is_not_the_display_window(tmp_path: Path) -> None:
    """The picture is 20 x 10; pixels were written from (-2, 3) to (6, 12), beyond its left and lower edge."""
    values = np.arange(1, 91, dtype=np.float32).reshape(10, 9)
    about = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    about |= {"dataWindow": ((-2, 3), (6, 12)), "displayWindow": ((0, 0), (19, 9))}
    OpenEXR.File(about, {"Y": values}).write(str(tmp_path / "a.exr"))
    found = exr.read(tmp_path / "a.exr").channels["Y"]
    wanted = np.zeros((10, 20), np.float32)
    wanted[3:10, 0:7] = values[0:7, 2:9]
    np.testing.assert_array_equal(found, wanted)
    assert exr.size(tmp_path / "a.exr") == (10, 20)


def test_a_deep_image_is_refused_before_it_is_read(tmp_path: Path) -> None:
    samples = np.empty((H, W), dtype=object)
    for place in np.ndindex(H, W):
        samples[place] = np.array([1.0, 2.0], np.float32)
    about = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    OpenEXR.File(about, {"Z": samples}).write(str(tmp_path / "a.exr"))
    for look in (exr.header, exr.read, images.about):
        with pytest.raises(ClipError, match="is a deep image; flatten it"):
            look(tmp_path / "a.exr")


def sized(source: bytes, data: tuple[int, int, int, int] | None, display: tuple[int, int, int, int] | None) -> bytes:
    """A file whose header claims other windows."""
    for name, corners in ((b"dataWindow", data), (b"displayWindow", display)):
        place = source.index(name + b"\0box2i\0") + len(name) + 11
        source = source if corners is None else source[:place] + struct.pack("<4i", *corners) + source[place + 16 :]
    return source


@pytest.mark.parametrize(
    ("data", "display"),
    [
        ((0, 0, 2**29, 2**29), (0, 0, 2**29, 2**29)),
        (None, (0, 0, 65535, 65535)),
        ((0, 0, 65535, 65535), None),
        ((0, 0, 2**28, 8), None),
        (None, (0, 0, 16383, 16383)),
        ((5, 5, 2, 2), None),
        (None, (-(2**31), -(2**31), 2**31 - 1, 2**31 - 1)),
    ],
)
def test_claims_of_impossible_sizes_are_refused(
    tmp_path: Path, data: tuple[int, int, int, int] | None, display: tuple[int, int, int, int] | None
) -> None:
    exr.write(tmp_path / "a.exr", planes())
    (tmp_path / "a.exr").write_bytes(sized((tmp_path / "a.exr").read_bytes(), data, display))
    for look in (exr.header, exr.read):
        with pytest.raises(ClipError):
            look(tmp_path / "a.exr")


def test_damaged_files_raise_nothing_but_sentences(tmp_path: Path) -> None:
    dice, path = random.Random(3), tmp_path / "a.exr"
    sources = []
    for kind, tiled in (("ZIP", False), ("PIZ", False), ("DWAA", False), ("B44", True), ("HTJ2K32", False)):
        OpenEXR.File(header(kind, tiled), dict(planes())).write(str(path))
        sources.append(path.read_bytes())
    refused = 0
    for _ in range(200):
        damaged = bytearray(dice.choice(sources))
        for _ in range(dice.randint(1, 5)):
            place = dice.randrange(min(len(damaged), 400) if dice.random() < 0.7 else len(damaged))
            damaged[place] = dice.choice((0, 1, 127, 128, 255, dice.randrange(256)))
        path.write_bytes(damaged[: dice.randrange(len(damaged))] if dice.random() < 0.2 else damaged)
        for look in (exr.header, exr.read):
            try:
                look(path)
            except ClipError as error:
                refused += "\n" not in str(error)
    assert refused > 200


def test_channel_names_that_are_no_text_are_refused(tmp_path: Path) -> None:
    exr.write(tmp_path / "a.exr", {"Zq": np.zeros((2, 2), np.float32)})
    (tmp_path / "a.exr").write_bytes((tmp_path / "a.exr").read_bytes().replace(b"Zq\0", b"\xff\xfe\0"))
    with pytest.raises(ClipError, match="channel names that are no text"):
        exr.header(tmp_path / "a.exr")


# Other kinds of files.


def test_what_is_written_is_read(tmp_path: Path) -> None:
    held = {name: np.linspace(0, 1, H * W, dtype=np.float32).reshape(H, W) ** (k + 1) for k, name in enumerate("BGR")}
    for name in ("a.exr", "a.png"):
        images.write(tmp_path / name, held)
        found = images.read(tmp_path / name, ("R", "G", "B"))
        np.testing.assert_allclose(found, np.stack([held[c] for c in "RGB"]), atol=0 if "exr" in name else 0.002)
    for name in ("a.npy", "a.npz"):
        images.write(tmp_path / name, {str(k): held[c] for k, c in enumerate("BGR")})
        np.testing.assert_allclose(
            images.read(tmp_path / name, ("2", "0")), np.stack((held["R"], held["B"])), atol=1e-3
        )
        assert images.about(tmp_path / name).names == ("0", "1", "2")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.exr", "a.npy", "a.npz", "a.png"]


def test_a_grey_picture_has_one_channel(tmp_path: Path) -> None:
    images.write(tmp_path / "a.png", {"Y": np.full((H, W), 102 / 255)})
    assert images.about(tmp_path / "a.png") == images.About((H, W), ("Y",), 8, {})
    np.testing.assert_allclose(images.read(tmp_path / "a.png", ("Y",)), np.full((1, H, W), 0.4))


def bomb(path: Path) -> None:
    """A PNG that claims 2 ** 30 pixels a side."""
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 2**30, 2**30, 8, 2, 0, 0, 0) + b"\0" * 40
    )


def pickled(path: Path) -> None:
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)


def huge(path: Path) -> None:
    """An array whose header claims a terabyte."""
    np.save(path, np.zeros((2, 2), np.float32))
    path.write_bytes(path.read_bytes().replace(b"(2, 2), }          ", b"(999999, 262144), }"))


HOSTILE: list[tuple[str, Callable[[Path], object]]] = [
    ("a.png", bomb),
    ("a.png", lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n")),
    ("a.jpg", lambda path: path.write_bytes(b"no")),
    ("a.npy", pickled),
    ("a.npy", huge),
    ("a.npy", lambda path: np.save(path, np.zeros(5))),
    ("a.npz", lambda path: path.write_bytes(b"PK\x03\x04")),
    ("a.npz", lambda path: np.savez(path, a=np.zeros(4), b=np.zeros((2, 2), "U1"))),
]


def healthy(path: Path) -> bytes:
    """A small file of the kind that the name asks for."""
    if path.suffix == ".png":
        Image.fromarray(np.arange(8 * 9 * 4, dtype=np.uint8).reshape(8, 9, 4)).save(path)
    elif path.suffix == ".npz":
        np.savez_compressed(path, depth=np.arange(72, dtype=np.float32).reshape(8, 9), motion=np.zeros((8, 9, 2)))
    else:
        np.save(path, np.arange(72, dtype=np.float32).reshape(8, 9))
    return path.read_bytes()


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(("a.png", "a.npz", "a.npy")),
    st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), max_size=12),
    st.none() | st.integers(0, 300),
)
@example("a.npy", [(8, 1)], None)
def test_pictures_and_arrays_that_are_damaged_raise_nothing_but_sentences(
    tmp_path_factory: pytest.TempPathFactory, name: str, changes: list[tuple[int, int]], end: int | None
) -> None:
    path = tmp_path_factory.mktemp("fuzz") / name
    data = bytearray(healthy(path))
    for place, value in changes:
        data[place % len(data)] = value
    path.write_bytes(data[:end])
    for look in (images.about, images.channels):
        said, found = "", None
        try:
            found = look(path)
        except ClipError as error:
            said = str(error)
        assert (str(path) in said and "\n" not in said) or found


def test_an_archive_may_hold_several_arrays_of_their_own_size(tmp_path: Path) -> None:
    depth, motion = np.arange(12.0).reshape(3, 4), np.arange(12.0).reshape(2, 3, 2)
    np.savez(tmp_path / "a.npz", depth=depth, motion=motion, seed=np.int64(3))
    about = images.about(tmp_path / "a.npz")
    assert about.names == ("depth.0", "motion.0", "motion.1")
    assert (about.size, about.size_of("motion.1")) == ((3, 4), (2, 3))
    np.testing.assert_array_equal(images.read(tmp_path / "a.npz", ("motion.1", "motion.0"))[0], motion[..., 1])
    with pytest.raises(ClipError, match="channels of one buffer differ in size"):
        images.read(tmp_path / "a.npz", ("depth.0", "motion.0"))


def test_a_part_of_lower_resolution_keeps_its_size(tmp_path: Path) -> None:
    corner, full, half = np.zeros(2, np.int32), np.array([15, 7], np.int32), np.array([7, 3], np.int32)
    common = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, "displayWindow": (corner, full)}
    color, vectors = np.ones((8, 16), np.float32), np.arange(32, dtype=np.float32).reshape(4, 8)
    parts = [
        OpenEXR.Part({**common, "name": "color", "dataWindow": (corner, full)}, dict.fromkeys("RGB", color)),
        OpenEXR.Part({**common, "name": "mv", "dataWindow": (corner, half)}, dict.fromkeys(("mv.X", "mv.Y"), vectors)),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    about = images.about(tmp_path / "a.exr")
    assert (about.size, about.size_of("mv.X"), about.size_of("R")) == ((8, 16), (4, 8), (8, 16))
    np.testing.assert_array_equal(images.channels(tmp_path / "a.exr")["mv.Y"], vectors)
    assert exr.read(tmp_path / "a.exr").channels["mv.Y"].shape == (8, 16)  # else it may be a crop


@pytest.mark.parametrize(("name", "make"), HOSTILE)
def test_hostile_files_are_refused(tmp_path: Path, name: str, make: Callable[[Path], object]) -> None:
    make(tmp_path / name)
    for look in (images.about, images.channels):
        with pytest.raises(ClipError) as caught:
            look(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        images.about(tmp_path / f"none{name}")


def test_archives_that_unpack_to_too_much_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez_compressed(tmp_path / "a.npz", i=np.zeros((100, 100, 2), np.float16))
    assert images.about(tmp_path / "a.npz").size == (100, 100)
    monkeypatch.setattr(images, "LARGEST", 10_000)
    with pytest.raises(ClipError, match="40128 bytes when unpacked"):
        images.about(tmp_path / "a.npz")
