"""Weights that ship with the package: one safetensors file for each trained part, and its card beside it."""

from pathlib import Path

FOLDER = Path(__file__).parent
