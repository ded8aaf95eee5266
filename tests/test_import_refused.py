"""What is broken is said by `framecast import` in one sentence, with exit 2 and nothing left behind."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dump import lay, lay_generic, same
from wall import FRAMES, H, W

from framecast import exr
from framecast.cli import main
from framecast.importers import extranet, images, open_any
from framecast.importers.settings import (
    write_settings,
)

# The command line: one sentence, exit 2, nothing left behind.


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    code = main([str(a) for a in arguments])
    said = capsys.readouterr()
    assert code == 2, said.out
    assert said.err.startswith("framecast: ")
    assert "Traceback" not in said.err
    assert said.err.count("\n") == 1
    return said.err


def spoil(folder: Path, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    path = folder / name
    exr.write(path, {k: change(v) for k, v in exr.read(path).channels.items()})


def remove(*names: str) -> Callable[[Path], None]:
    return lambda folder: [(folder / name).unlink() for name in names] and None  # type: ignore[func-returns-value]


def another_shot(folder: Path) -> None:
    shutil.copy(folder / "beauty/take1.0010.exr", folder / "beauty/take2.0010.exr")


def one_frame(folder: Path) -> None:
    for path in folder.rglob("*.exr"):
        if "0010" not in path.name:
            path.unlink()


def eight_bits(folder: Path) -> None:
    about = json.loads((folder / "framecast-import.json").read_text())
    about["depth"] = {"files": "d{frame}.png", "channels": "R"}
    (folder / "framecast-import.json").write_text(json.dumps(about))
    for number in range(10, 10 + FRAMES):
        images.write(folder / f"d{number:04d}.png", dict.fromkeys("RGB", np.ones((H, W))))


def rename_key(folder: Path) -> None:
    path = folder / "framecast-import.json"
    path.write_text(path.read_text().replace('"kind"', '"knid"'))


def truncate(folder: Path) -> None:
    path = folder / "mv/0011.exr"
    path.write_bytes(path.read_bytes()[:-200])


def shrink(folder: Path) -> None:
    path = folder / "mv/0012.exr"
    exr.write(path, {k: v[:-2] for k, v in exr.read(path).channels.items()})


def lose_channel(folder: Path) -> None:
    path = folder / "mv/0012.exr"
    exr.write(path, {"R": exr.read(path).channels["R"], "GG": exr.read(path).channels["G"]})


def poison(folder: Path) -> None:
    spoil(folder, "beauty/take1.0012.exr", lambda plane: np.where(np.arange(W) == 3, np.nan, plane).astype(plane.dtype))


BROKEN: list[tuple[Callable[[Path], None], str]] = [
    (remove("beauty/take1.0011.exr", "mv/0011.exr", "depth/0011.exr"), "frame 11 is missing in the middle"),
    (remove("beauty/take1.0011.exr"), "color lacks frame 11, which other buffers have"),
    (remove("depth/0012.exr"), "depth lacks frame 12, which other buffers have"),
    (remove(*(f"mv/00{n}.exr" for n in range(10, 14))), "has no file mv/{frame}.exr for motion"),
    (another_shot, "holds 2 sequences .* put each shot into a folder of its own"),
    (one_frame, "holds 1 frame of a sequence; give at least two"),
    (eight_bits, "depth is stored in 8 bits, whose 256 steps are too coarse"),
    (rename_key, "depth.knid is not known; did you mean kind"),
    (truncate, "truncated or damaged"),
    (shrink, "0012.exr is 40x22 but the first one is 40x24"),
    (lose_channel, r"0012.exr lacks G for motion \(it has GG, R\)"),
    (poison, "frame 12 of .*: 72 NaN or infinite pixels in color; .* --repair"),
]


@pytest.mark.parametrize(("break_it", "said"), BROKEN)
def test_what_is_broken_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], break_it: Callable[[Path], None], said: str
) -> None:
    import re

    folder = lay_generic(tmp_path / "dump")
    break_it(folder)
    assert re.search(said, refused(capsys, "import", folder, "-o", tmp_path / "clip"))
    assert [path.name for path in tmp_path.iterdir()] == ["dump"]


def test_other_files_among_them_do_not_matter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = lay_generic(tmp_path / "dump")
    (folder / "notes.txt").write_text("mine")
    (folder / "depth" / ".0010.exr.swp").write_bytes(b"x")
    (folder / "preview.png").write_bytes(b"not a picture")
    (folder / "beauty" / "take1.0099.tmp").write_bytes(b"x")
    assert main(["import", str(folder), "-o", str(tmp_path / "clip"), "--full"]) == 0
    same(open_any(tmp_path / "clip"), ("color", "depth", "motion"))
    assert f"{tmp_path / 'clip'}: 4 frames written" in capsys.readouterr().out


def test_repair_on_the_way_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = lay_generic(tmp_path / "dump")
    poison(folder)
    assert main(["import", str(folder), "-o", str(tmp_path / "clip"), "--repair"]) == 0
    assert "72 NaN or infinite values replaced" in capsys.readouterr().out


def test_sources_can_be_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = lay(tmp_path / "dump", extranet.settings_of("S", set(extranet.BUFFERS)))
    out = tmp_path / "clip"
    assert "is not recognised" in refused(capsys, "import", folder, "-o", out, "--from", "unity")
    assert "unrael is not known; import from blender" in refused(
        capsys, "import", folder, "-o", out, "--from", "unrael"
    )
    assert "does not exist; let framecast doctor" in refused(capsys, "import", folder, "-o", out, "--from", "generic")
    settings = write_settings(extranet.settings_of("S", {"MotionVector"}), tmp_path / "mine.json")
    both = refused(capsys, "import", folder, "-o", out, "--from", "extranet", "--settings", settings)
    assert "leave --from extranet out" in both
    assert main(["import", str(folder), "-o", str(out), "--settings", str(settings)]) == 0
    assert open_any(out).layers == ("color", "motion")


def test_what_is_not_recognised_is_told_what_was_looked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exr.write(tmp_path / "x" / "a_0001.exr", {"foo.R": np.zeros((4, 4), np.float32)})
    said = refused(capsys, "import", tmp_path / "x", "-o", tmp_path / "clip")
    assert "holds 1 image file, such as a_{frame}.exr with the channels foo.R" in said
    assert "looked for what Blender, unreal, unity, extranet" in said
    assert len(said) < 500
    assert f"framecast doctor {tmp_path / 'x'}" in said
    assert "is not there; give the folder" in refused(capsys, "import", tmp_path / "y", "-o", tmp_path / "clip")
