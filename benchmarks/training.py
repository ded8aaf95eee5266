"""What training costs apart from arithmetic: reading crops against decoding files, and how long a step waits for data.

    python benchmarks/training.py 'clips/train/*' [--method extranet] [--steps 40] [--json training.json]

Reading is timed on the same samples both ways, in turn, in one process: the frames of a sample decoded from their EXR
files and cut, and the same crop from the training cache (mapped into memory, warm). Medians over samples.
"""

import argparse
import glob
import json
import statistics
import tempfile
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from framecast.data import Footage, footage, window
from framecast.exr import whole
from framecast.importers import open_any
from framecast.train import Settings, train, trainable


def milliseconds(run: Callable[[], object]) -> float:
    """Wall-clock time of one call."""
    began = clock.perf_counter()
    run()
    return (clock.perf_counter() - began) * 1e3


def reading(sources: Sequence[Footage], crop: int, fields: tuple[str, ...], count: int = 24) -> dict[str, float]:
    """Median milliseconds of the frames of a sample: decoded whole and cut, and read as a crop."""
    rng = np.random.default_rng(0)
    decoded, mapped = [], []
    for k in range(count):
        source = sources[k % len(sources)]
        start = int(rng.integers(len(source.clip) - 5))
        top, left = (int(rng.integers(max(1, side - crop + 1))) for side in source.clip.size)
        side = (min(crop, source.clip.size[0]), min(crop, source.clip.size[1]))
        numbers = (start, start + 2, start + 4, start + 5)

        def decode(source: Footage = source, numbers: Sequence[int] = numbers) -> list[Any]:
            return [source.clip[i] for i in numbers]

        def read(
            source: Footage = source,
            at: tuple[int, int] = (top, left),
            numbers: Sequence[int] = numbers,
            side: tuple[int, int] = side,
        ) -> list[Any]:
            part = window(source, at, side, fields)
            return [part[i] for i in numbers]

        read()  # pages of the file in memory, as after the first passes over the clips
        decoded.append(milliseconds(decode))
        mapped.append(milliseconds(read))
    slow, fast = statistics.median(decoded), statistics.median(mapped)
    return {"decoded_ms": slow, "cache_ms": fast, "ratio": slow / fast}


def throughput(
    name: str, sources: Sequence[Footage], steps: int, batch: int, crop: int, workers: int
) -> dict[str, Any]:
    """Samples a second of training, and the part of the time that it waits for them, without the first quarter."""
    make, recipe = trainable(name)
    recipe = replace(recipe, steps=steps, batch=batch, crop=(crop, crop))
    torch.manual_seed(0)
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        train(name, make(), recipe, sources, run, Settings(log=max(1, steps // 4), pictures=0, workers=workers))
        lines = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    later = lines[len(lines) // 4 :]
    found = {key: statistics.median(line[key] for line in later) for key in ("samples_per_second", "waiting")}
    return {"workers": workers, **found}


def main() -> None:
    """Measures, prints, and writes what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", help="pattern of training clips, in quotes")
    parser.add_argument("--method", default="extranet")
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--crop", type=int, default=128)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        sources = [footage(open_any(path), Path(cache)) for path in sorted(glob.glob(chosen.clips))]
        make, _ = trainable(chosen.method)
        method: Any = make()
        fields = tuple(dict.fromkeys((*method.needs, *method.needs_generated, "color", "motion2")))
        found: dict[str, Any] = {
            "size": sources[0].clip.size,
            "crop": chosen.crop,
            "batch": chosen.batch,
            "threads": torch.get_num_threads(),
            "reading": reading(sources, chosen.crop, fields),
            "training": [
                throughput(chosen.method, sources, chosen.steps, chosen.batch, chosen.crop, workers)
                for workers in (0, 1)
            ],
        }
    print(json.dumps(found, indent=1))
    if chosen.json:
        with whole(chosen.json) as temporary:
            temporary.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
