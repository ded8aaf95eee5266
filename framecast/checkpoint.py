"""Weights and optimiser state as safetensors files that say what they belong to."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import safetensors.torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from framecast.exr import whole

Module = Any
"""A method with a `config`."""


def save(path: Path, tensors: Mapping[str, Tensor], about: Mapping[str, Any]) -> None:
    """Writes the file whole or not at all.

    Raises:
        ClipError: it cannot be written (no space, no permission).
    """
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    metadata = {key: json.dumps(value, sort_keys=True) for key, value in about.items()}
    with whole(path) as temporary:
        temporary.write_bytes(safetensors.torch.save(plain, metadata))


def load(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors by name, and what the file says of itself.

    Raises:
        FileNotFoundError: no such file. ValueError: truncated, damaged, or not of this project.
    """
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise FileNotFoundError(f"{path} {what}; give a file that framecast train wrote (weights.safetensors)")
    try:
        with safe_open(path, framework="pt") as file:
            about = {key: json.loads(text) for key, text in (file.metadata() or {}).items()}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, json.JSONDecodeError, OSError) as error:
        raise ValueError(f"{path} is truncated or damaged ({error}); copy it again or train again") from error
    if "method" not in about:
        raise ValueError(f"{path} does not say which method it belongs to; give a file that framecast train wrote")
    return tensors, about


def describe(name: str, method: Module) -> dict[str, Any]:
    """What a file of this method says of itself."""
    return {"method": name, "config": json.loads(json.dumps(asdict(method.config)))}


def require(path: Path, about: Mapping[str, Any], name: str, method: Module) -> None:
    """Raises ValueError where a file belongs to another method or another configuration of it."""
    if about["method"] != name:
        raise ValueError(f"{path} holds {about['method']}, not {name}; ask for that method, or give another file")
    wanted, found = describe(name, method)["config"], about["config"]
    if found != wanted:
        differ = [key for key in sorted({*wanted, *found}) if wanted.get(key) != found.get(key)]
        each = ", ".join(f"{key} {found.get(key)!r} instead of {wanted.get(key)!r}" for key in differ)
        raise ValueError(
            f"{path} was trained with another configuration of {name}: {each}; use its own, or train again"
        )


def fill(method: Module, name: str, path: Path) -> Module:
    """The method with the weights of a file.

    Raises:
        FileNotFoundError: no such file. ValueError: it is damaged, or of another method or configuration.
    """
    tensors, about = load(path)
    require(path, about, name, method)
    put(method, {key: value for key, value in tensors.items() if not key.startswith("optimiser.")}, path)
    return method


def put(method: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Copies weights into the method; ValueError where names or sizes are not its own."""
    try:
        method.load_state_dict(dict(tensors))
    except RuntimeError as error:
        first = str(error).splitlines()[-1].strip()
        raise ValueError(f"{path} does not fit this version of the method: {first}; train again") from error
