"""Weights that ship with the package: one safetensors file for each trained part, and its card beside it."""

from pathlib import Path
from typing import TypeVar

import safetensors.torch
from safetensors import SafetensorError
from torch import nn

FOLDER = Path(__file__).parent

M = TypeVar("M", bound=nn.Module)


def shipped(name: str, method: M) -> M:
    """The method, ready to run, with the weights NAME.safetensors of this folder, perhaps stored in half precision.

    Raises:
        FileNotFoundError: there is no such file. ValueError: it is damaged, or not of this method.
    """
    path = FOLDER / f"{name}.safetensors"
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; install framecast again, or train: framecast train {name}")
    try:
        method.load_state_dict(safetensors.torch.load_file(path))
    except (SafetensorError, RuntimeError) as error:
        what = str(error).splitlines()[-1].strip()
        raise ValueError(f"{path} is damaged, or of another version ({what}); install framecast again") from error
    return method.eval()
