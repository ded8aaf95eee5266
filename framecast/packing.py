"""Images as text inside of a page: logarithmic codes, each predicted from its neighbours, deflated.

A browser undoes it in `page/images.js`, which keeps the codes, so that exposure is a table look-up and the value of a
pixel is known. One 480x270 frame of path-traced colour takes 250 kB, and what is shown is at most 0.4 of 256 levels off
at any exposure between -4 and +4 stops. For comparison, as lossless WebP: 8 bits of display colour 173 kB, 8 levels off
at +4 stops; 8 bits of logarithm 112 kB, 3.5 levels off without any exposure. Half floats in this packing: 340 kB.
"""

import base64
import zlib

import numpy as np
import torch
from jaxtyping import Float, Int32, UInt16
from torch import Tensor

STEPS = 96
"""Codes for a factor of two: values are within 0.4 % of what they were."""

FLOOR = 1024
"""The scale is logarithmic above 1 / FLOOR and linear below."""

BRIGHTEST = 65504.0
"""Largest value, that of half floats; larger ones become it."""


def encode(linear: Float[Tensor, "3 h w"]) -> UInt16[np.ndarray, "3 h w"]:
    """Codes round(STEPS log2(1 + FLOOR x)) of linear colour; below 0 becomes 0."""
    clamped = linear.double().clamp(0, BRIGHTEST)
    return (STEPS * torch.log2(1 + FLOOR * clamped)).round().cpu().numpy().astype(np.uint16)


def pack(codes: UInt16[np.ndarray, "c h w"]) -> str:
    """Text of an image of one or three planes: base64 of zlib of the low, then high bytes of what prediction missed.

    Three planes become green, red - green and blue - green first. A miss m is written as 2m, or -2m - 1 below 0.
    """
    planes = codes.astype(np.int32)
    if len(planes) == 3:
        red, green, blue = planes
        planes = np.stack((green, red - green, blue - green))
    missed = np.stack([plane - predicted(plane) for plane in planes])
    signless = ((missed << 1) ^ (missed >> 31)).astype(np.uint16)
    squeeze = zlib.compressobj(6, zlib.DEFLATED, 15, 9, zlib.Z_FILTERED)
    raw = (signless & 255).astype(np.uint8).tobytes() + (signless >> 8).astype(np.uint8).tobytes()
    return base64.b64encode(squeeze.compress(raw) + squeeze.flush()).decode()


def predicted(plane: Int32[np.ndarray, "h w"]) -> Int32[np.ndarray, "h w"]:
    """What the pixels left (a), above (b) and above left (c) say of each: the median of a, b and a + b - c (LOCO-I).

    In the first row the pixel left of it, in the first column the one above, and 0 for the very first.
    """
    a, b, c = (np.zeros_like(plane) for _ in range(3))
    a[:, 1:], b[1:], c[1:, 1:] = plane[:, :-1], plane[:-1], plane[:-1, :-1]
    middle = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), a + b - c))
    middle[0], middle[:, 0] = a[0], b[:, 0]
    return middle
