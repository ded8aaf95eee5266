"""Weights that ship with the package: one safetensors file for each trained method, and its card beside it."""

from pathlib import Path
from typing import TypeVar

import safetensors.torch
from torch import nn

FOLDER = Path(__file__).parent

Module = TypeVar("Module", bound=nn.Module)


def shipped(name: str, method: Module) -> Module:
    """The method with the weights that ship under this name.

    Raises:
        FileNotFoundError: none ship under it. RuntimeError: they are of another configuration.
    """
    path = FOLDER / f"{name}.safetensors"
    if not path.is_file():
        raise FileNotFoundError(
            f"no weights ship for {name} ({path} is missing); train it with: framecast train {name}"
        )
    method.load_state_dict(safetensors.torch.load_file(path))
    return method
