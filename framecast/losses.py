"""What training compares: terms that recipes share."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def difference(image: Float[Tensor, "b 3 H W"], target: Float[Tensor, "b 3 H W"]) -> dict[str, Float[Tensor, ""]]:
    """1 - SSIM and 5 L1 of two images in [0, 1], as networks see them."""
    return {"ssim": 1 - similarity(image, target), "l1": 5 * (image - target).abs().mean()}


def similarity(image: Float[Tensor, "b 3 H W"], target: Float[Tensor, "b 3 H W"]) -> Float[Tensor, ""]:
    """Mean structural similarity over windows of 7 x 7 pixels, three pixels apart; 1 where the images are equal."""
    with torch.autocast(image.device.type, enabled=False):
        a, b = image.float(), target.float()
        mean_a, mean_b, squares, products = F.avg_pool2d(torch.cat((a, b, a * a + b * b, a * b), 1), 7, 3).chunk(4, 1)
        means, product = mean_a * mean_a + mean_b * mean_b, mean_a * mean_b
        light = (2 * product + 1e-4) / (means + 1e-4)
        form = (2 * (products - product) + 9e-4) / (squares - means + 9e-4)
        return (light * form).mean()


def charbonnier(difference: Float[Tensor, "b c h w"]) -> Float[Tensor, ""]:
    """Mean of sqrt(d^2 + 1e-6): L1 with a slope that does not jump at 0."""
    return (difference.square() + 1e-6).sqrt().mean()


def census(a: Float[Tensor, "b c h w"], b: Float[Tensor, "b c h w"], side: int = 7) -> Float[Tensor, ""]:
    """How differently two images rise and fall around their pixels; the same brightness added to one changes nothing.

    Meister et al. 2018 (UnFlow), smooth: each of the `side` x `side` differences d to a neighbour becomes
    d / sqrt(0.81 + d^2), and two of them that are e apart count e^2 / (0.1 + e^2). Channel by channel; borders, where
    there are no neighbours, do not count.
    """
    apart = (_rises(a, side) - _rises(b, side)).square()
    return (apart / (0.1 + apart)).mean()


def _rises(image: Float[Tensor, "b c h w"], side: int) -> Float[Tensor, "n b c i j"]:
    """Differences of the neighbours to each pixel that has all of them, compressed."""
    edge = side // 2
    height, width = (n - 2 * edge for n in image.shape[-2:])
    middle = image[..., edge : edge + height, edge : edge + width]
    rises = [
        image[..., y : y + height, x : x + width] - middle
        for y in range(side)
        for x in range(side)
        if (y, x) != (edge, edge)
    ]
    rise = torch.stack(rises)
    return rise / (0.81 + rise.square()).sqrt()
