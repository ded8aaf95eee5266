"""Colour: transfer curves with their inverses, exposure, the display transform, demodulation.

Everything here works per element on any shape. Curves come in pairs; `decode(encode(x)) == x` within rounding on the
stated range. Inside the package colour is scene-linear Rec.709 times exposure (see `frame.py`).
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

_SHOULDER = 0.8
"""Where the display curve leaves the identity: darker pixels look exactly as a plain sRGB view shows them."""

ALBEDO_FLOOR = 0.01
"""Smallest divisor of `demodulate`, so that black surfaces do not amplify noise without bound."""


def encode_srgb(linear: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """sRGB transfer function (IEC 61966-2-1) of linear values in [0, 1]; values outside continue the curve's ends."""
    curve = 1.055 * linear.clamp(min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curve)


def decode_srgb(encoded: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Inverse of `encode_srgb`."""
    curve = ((encoded.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(encoded <= 0.04045, encoded / 12.92, curve)


def compress_highlights(linear: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Values from [0, inf) to [0, 1): identity up to 0.8, then an exponential shoulder with continuous slope."""
    room = 1 - _SHOULDER
    shoulder = 1 - room * torch.exp(-(linear - _SHOULDER).clamp(min=0) / room)
    return torch.where(linear <= _SHOULDER, linear, shoulder)


def expand_highlights(compressed: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Inverse of `compress_highlights`; accurate to 1 % up to about 2.5 in float32, 1 maps to a finite large value."""
    room = 1 - _SHOULDER
    above = _SHOULDER - room * torch.log(((1 - compressed) / room).clamp(min=1e-7, max=1))
    return torch.where(compressed <= _SHOULDER, compressed, above)


def to_display(linear: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """The one display transform: highlights compressed per channel, then sRGB; result in [0, 1].

    Every metric and every picture uses it. Below 0.8 it equals the plain sRGB view ("Standard" in Blender); above,
    highlights stay distinguishable in place of clipping. Negative input becomes 0.
    """
    return encode_srgb(compress_highlights(linear.clamp(min=0))).clamp(0, 1)


def from_display(display: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Inverse of `to_display` on [0, 1]."""
    return expand_highlights(decode_srgb(display))


def expose(linear: Float[Tensor, "*s"], stops: float) -> Float[Tensor, "*s"]:
    """Colour brighter by `stops` (factors of two)."""
    return linear * 2.0**stops


def encode_log(linear: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """log(1 + x): the domain in which ExtraNet and FASSET work; input at least 0."""
    return torch.log1p(linear.clamp(min=0))


def decode_log(encoded: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Inverse of `encode_log`, at least 0."""
    return torch.expm1(encoded).clamp(min=0)


def encode_mu(linear: Float[Tensor, "*s"], mu: float = 8.0) -> Float[Tensor, "*s"]:
    """mu-law, log(1 + mu x) / log(1 + mu): 0 to 0 and 1 to 1; input at least 0."""
    return torch.log1p(mu * linear.clamp(min=0)) / math.log1p(mu)


def decode_mu(encoded: Float[Tensor, "*s"], mu: float = 8.0) -> Float[Tensor, "*s"]:
    """Inverse of `encode_mu`, at least 0."""
    return (torch.expm1(encoded * math.log1p(mu)) / mu).clamp(min=0)


def tonemap(linear: Float[Tensor, "b 3 *s"]) -> Float[Tensor, "b 3 *s"]:
    """x / (1 + max(r, g, b)): the reversible curve in which accumulation averages without fireflies (FSR2)."""
    return linear / (1 + linear.amax(1, keepdim=True))


def untonemap(compressed: Float[Tensor, "b 3 *s"]) -> Float[Tensor, "b 3 *s"]:
    """Inverse of `tonemap`; finite at 1."""
    return compressed / (1 - compressed.amax(1, keepdim=True)).clamp(min=1 / 65504)


def luminance(linear: Float[Tensor, "b 3 *s"]) -> Float[Tensor, "b 1 *s"]:
    """Rec.709 relative luminance of linear colour."""
    r, g, b = linear[:, 0:1], linear[:, 1:2], linear[:, 2:3]
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def demodulate(color: Float[Tensor, "b 3 *s"], albedo: Float[Tensor, "b 3 *s"]) -> Float[Tensor, "b 3 *s"]:
    """Colour divided by surface colour, max(albedo, 0.01): what is left is light. Undone by `modulate`."""
    return color / albedo.clamp(min=ALBEDO_FLOOR)


def modulate(light: Float[Tensor, "b 3 *s"], albedo: Float[Tensor, "b 3 *s"]) -> Float[Tensor, "b 3 *s"]:
    """Inverse of `demodulate`: light times max(albedo, 0.01)."""
    return light * albedo.clamp(min=ALBEDO_FLOOR)
