"""What numbers were made from: clips with their hashes, methods with their settings, versions, the machine."""

import hashlib
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from framecast.clip import Clip


@dataclass(frozen=True)
class Source:
    """A clip as it was evaluated."""

    path: str
    frames: int
    size: tuple[int, int]
    """Height and width."""
    fps: float
    sha256: str
    """See `fingerprint`."""


@dataclass(frozen=True)
class About:
    """What stands beside the rows of a results file."""

    clips: Mapping[str, Source]
    """By the name that the rows use."""
    methods: Mapping[str, Mapping[str, Any]]
    """Configuration of each method, and the hash of its weights where it has any."""
    settings: Mapping[str, Any]
    machine: Mapping[str, Any]
    """`machine`, and the version of framecast."""


def read_about(held: Mapping[str, Any]) -> About:
    """`About` from the JSON that `asdict` of it became; raises KeyError or TypeError where it is not that."""
    clips = {label: Source(**{**one, "size": tuple(one["size"])}) for label, one in held["clips"].items()}
    return About(clips, held["methods"], held["settings"], held["machine"])


def source(clip: Clip) -> Source:
    """A clip as it is now."""
    return Source(str(clip.path.resolve()), len(clip), clip.size, clip.fps, fingerprint(clip.path))


def described(method: nn.Module) -> dict[str, Any]:
    """Configuration, and the SHA-256 of all weights in the order of their names."""
    config = getattr(method, "config", None)
    found: dict[str, Any] = asdict(config) if is_dataclass(config) and not isinstance(config, type) else {}
    weights = method.state_dict()
    if weights:
        digest = hashlib.sha256()
        for name in sorted(weights):
            digest.update(name.encode() + weights[name].detach().cpu().float().numpy().tobytes())
        found["weights_sha256"] = digest.hexdigest()
    plain: dict[str, Any] = json.loads(json.dumps(found))
    return plain


def fingerprint(folder: Path) -> str:
    """SHA-256 of names and contents of the images in a folder and of its JSON files, in the order of their names."""
    digest = hashlib.sha256()
    for path in files(folder):
        digest.update(f"{path.relative_to(folder).as_posix()} {path.stat().st_size}\n".encode())
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def files(folder: Path) -> Sequence[Path]:
    """Everything in a folder that a clip is read from; hidden files are not."""
    found = (path for path in folder.rglob("*") if path.suffix.lower() in (".exr", ".json", ".png"))
    return sorted(path for path in found if path.is_file() and not path.name.startswith("."))


def machine(device: str = "cpu") -> dict[str, str | int | float]:
    """What the numbers depend on besides the code."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    described: dict[str, str | int | float] = {
        "cpu": names[0] if names else platform.processor() or platform.machine(),
        "cores": os.cpu_count() or 1,
        "threads": torch.get_num_threads(),
        "instructions": torch.backends.cpu.get_cpu_capability(),
        "torch": torch.__version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }
    if hasattr(os, "getloadavg"):
        described["load"] = round(os.getloadavg()[0], 1)
    if device.startswith("cuda"):
        described["gpu"] = torch.cuda.get_device_name(device)
    return described
