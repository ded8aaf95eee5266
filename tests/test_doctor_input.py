"""What is wrong with a folder is said in one sentence: mixed shots, holes, damage, headers that lie."""

import random
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from framecast import exr
from framecast.cli import main
from framecast.clip import Record, finish, write_frame
from framecast.doctor.source import open_source
from framecast.doctor.take import load
from framecast.exr import ClipError

RNG = np.random.default_rng(3)


def picture(name: Path, size: tuple[int, int] = (24, 32), **more: np.ndarray) -> None:
    """One EXR with colour and vectors."""
    channels = {c: RNG.uniform(0, 1, size).astype(np.float32) for c in "RGB"}
    channels |= {f"motion.{c}": RNG.normal(size=size).astype(np.float32) for c in "XY"}
    exr.write(name, channels | more)


def shot(folder: Path, numbers: range = range(1, 4), stem: str = "", size: tuple[int, int] = (24, 32)) -> Path:
    for number in numbers:
        picture(folder / f"{stem}{number:04d}.exr", size)
    return folder


def two_sizes(folder: Path) -> None:
    shot(folder)
    shot(folder, range(4, 6), size=(20, 32))


def two_shots(folder: Path) -> None:
    shot(folder, stem="a_")
    shot(folder, stem="b_")


def two_takes(folder: Path) -> None:
    """One file a buffer, as Unity's recorder writes them, of two takes."""
    for take in ("", "take2_"):
        for number in (1, 2, 3):
            for name, letters in (("Beauty", "RGB"), ("MotionVectors", "RG")):
                planes = {c: RNG.uniform(0, 1, (24, 32)).astype(np.float32) for c in letters}
                exr.write(folder / f"{take}{name}_{number:04d}.exr", planes)


def torn(folder: Path) -> None:
    shot(folder)
    path = folder / "0002.exr"
    path.write_bytes(path.read_bytes()[:600])


def no_numbers(folder: Path) -> None:
    picture(folder / "frame.exr")


def only_text(folder: Path) -> None:
    (folder / "notes.txt").write_text("nothing to see")


def unshaded(folder: Path) -> None:
    plane = np.ones((3, 24, 32), np.float32)
    for number in (1, 2, 3):
        layers = {"motion": plane[:2]} if number == 2 else {"motion": plane[:2], "color": plane}
        write_frame(folder, Record(number, float(number)), layers)
    finish(folder, fps=24)


REFUSED: dict[str, tuple[Callable[[Path], object], str]] = {
    "one frame": (lambda f: shot(f, range(1, 2)), "holds one frame"),
    "two sizes": (two_sizes, "two shots"),
    "two shots": (two_shots, "2 shots"),
    "two takes": (two_takes, "2 shots"),
    "torn": (torn, "truncated or damaged"),
    "no numbers": (no_numbers, "no numbered image file"),
    "a clip with frames to generate": (unshaded, "has no colour in frame 2; "),
    "no images": (only_text, "holds no image file"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_examined_is_said_in_a_sentence(tmp_path: Path, what: str, capsys) -> None:
    folder = tmp_path / "dump"
    folder.mkdir()
    make, words = REFUSED[what]
    make(folder)
    assert main(["doctor", str(folder), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert words in said
    assert said.count("\n") == 0
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_not_there(tmp_path: Path, capsys) -> None:
    assert main(["doctor", str(tmp_path / "none")]) == 2
    assert "not there" in capsys.readouterr().err


def test_holes_and_nan_are_remarks_and_other_files_are_left_alone(tmp_path: Path) -> None:
    shot(tmp_path, range(1, 4))
    shot(tmp_path, range(5, 8))
    bad = np.full((24, 32), np.nan, np.float32)
    picture(tmp_path / "0002.exr", **{"motion.X": bad})
    (tmp_path / "readme.md").write_text("a shot")
    source = open_source(tmp_path)
    assert any("frame 4 is missing" in remark for remark in source.remarks)
    take = load(source)
    assert take.blemishes == {"motion": 24 * 32}
    assert take.joined == (False, True, True, False, True, True)


def test_layers_are_found_by_name_and_without_one_by_their_numbers(tmp_path: Path) -> None:
    y, x = np.mgrid[0:24, 0:32].astype(np.float32)
    normal = np.stack([np.sin(x / 9), np.cos(x / 9), 0 * x])
    for number in (1, 2):
        layers = {f"p.{c}": RNG.gamma(0.5, size=(24, 32)).astype(np.float32) for c in "RGB"}
        layers |= {f"q.{c}": RNG.normal(size=(24, 32)).astype(np.float32) for c in "XY"}
        layers |= {"r.X": (5 + x / 7 + y / 3).astype(np.float32)}
        layers |= {f"s.{c}": p for c, p in zip("XYZ", normal, strict=True)}
        exr.write(tmp_path / f"{number:03d}.exr", layers)
    claim = open_source(tmp_path).claim
    told = {name: getattr(claim, name).channels[0][0] for name in ("color", "motion", "depth", "normal")}
    assert told == {"color": "p", "motion": "q", "depth": "r", "normal": "s"}


def test_one_file_a_buffer_and_packed_vectors(tmp_path: Path) -> None:
    for number in (1, 2):
        for name, channels in (("beauty", 3), ("velocity", 4)):
            codes = RNG.integers(0, 255, (24, 32, channels), dtype=np.uint8)
            Image.fromarray(codes).save(tmp_path / f"{name}_{number:04d}.png")
    claim = open_source(tmp_path).claim
    assert claim.color is not None
    assert claim.color.encoding == "srgb"
    assert claim.motion is not None
    assert claim.motion.channels == ("R", "G", "B", "A")
    assert claim.motion.packing == "base255"


def test_headers_that_promise_too_much_ask_for_no_memory(tmp_path: Path) -> None:
    shot(tmp_path)
    path = tmp_path / "0002.exr"
    data = bytearray(path.read_bytes())
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = data.find(name) + len(name) + 4
        data[at : at + 16] = struct.pack("<4i", 0, 0, 99_999, 99_999)
    path.write_bytes(data)
    with pytest.raises(ClipError, match="cannot"):
        exr.read(path)


def test_bytes_turned_at_random_never_end_in_a_traceback(tmp_path: Path) -> None:
    whole = shot(tmp_path / "whole", size=(12, 16))
    chance = random.Random(5)
    for turn in range(16):
        folder = tmp_path / f"{turn}"
        shutil.copytree(whole, folder)
        path = folder / f"000{chance.choice('123')}.exr"
        data = bytearray(path.read_bytes())
        for _ in range(chance.choice((1, 4, 40))):
            data[chance.randrange(len(data) if turn % 2 else 400)] = chance.randrange(256)
        path.write_bytes(data[: chance.choice((len(data), len(data), len(data) // 2))])
        assert main(["doctor", str(folder), "-o", str(tmp_path / "out")]) in (0, 1, 2)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"version": 1}', '{"motion": 3}', "\0\1", '{"color": {"files": 1}}'])
def test_settings_and_clip_files_that_are_none(tmp_path: Path, text: str, capsys) -> None:
    for name in ("clip.json", "framecast-import.json"):
        folder = shot(tmp_path / name)
        (folder / name).write_text(text)
        assert main(["doctor", str(folder), "-o", str(tmp_path / "out")]) == 2
        assert name in capsys.readouterr().err
