"""Network blocks that methods share, and a count of what a network costs."""

from collections.abc import Callable
from typing import Any

import torch
import torch.distributed as dist
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


class BatchNorm(nn.BatchNorm2d):
    """Batch normalisation over the batches of all processes that train together, on any device.

    With one process, and when not training, it is the ordinary layer; with several, each with its part of a batch, it
    computes what one process computes with the whole batch.
    """

    def forward(self, input: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        if not (self.training and dist.is_initialized() and dist.get_world_size() > 1):
            return super().forward(input)
        count = torch.tensor(float(input.shape[0] * input.shape[2] * input.shape[3]), device=input.device)
        values = input.float()
        sums = torch.cat((values.sum((0, 2, 3)), values.square().sum((0, 2, 3)), count[None]))
        sums = _summed(sums)
        total = sums[-1]
        mean, square = (sums[:-1] / total).chunk(2)
        variance = (square - mean.square()).clamp(min=0)  # of a constant far from 0 rounding leaves less
        self._remember(mean.detach(), (variance * total / (total - 1)).detach())
        scale = self.weight * (variance + self.eps).rsqrt()
        shift = self.bias - mean * scale
        return (values * scale[:, None, None] + shift[:, None, None]).to(input.dtype)

    def _remember(self, mean: Tensor, variance: Tensor) -> None:
        """Running statistics for use after training."""
        assert self.running_mean is not None
        assert self.running_var is not None
        assert self.momentum is not None
        assert self.num_batches_tracked is not None
        with torch.no_grad():
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance, self.momentum)
            self.num_batches_tracked.add_(1)


class _Sum(torch.autograd.Function):
    """Sum over all processes, forward and backward."""

    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        total = values.clone()
        dist.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        total = gradient.clone()
        dist.all_reduce(total)
        return total


def _summed(values: Tensor) -> Tensor:
    return _Sum.apply(values)


class GatedConv(nn.Module):
    """Light-weight gated convolution: values times one mask for all channels, O = conv_f(X) * sigmoid(conv_m(X)).

    Guo et al. 2021, section 4.3. 3 x 3. One convolution computes both, the mask as its last channel. What follows the
    product (normalisation, rectifier) is `norm`.
    """

    def __init__(self, inputs: int, outputs: int, *, stride: int = 1, norm: bool = True) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs + 1, 3, stride, 1)
        self.norm = nn.Sequential(BatchNorm(outputs), nn.ReLU()) if norm else nn.Identity()

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d H W"]:
        both = self.conv(x)
        gated: Tensor = self.norm(both[:, :-1] * torch.sigmoid(both[:, -1:]))
        return gated


def conv(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """3 x 3 convolution, batch normalisation, rectifier."""
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, 1), BatchNorm(outputs), nn.ReLU())


class Up(nn.Module):
    """Twice the size, bilinear, joined with the features of that size, then two convolutions."""

    def __init__(self, inputs: int, middle: int, outputs: int) -> None:
        super().__init__()
        self.convs = nn.Sequential(conv(inputs, middle), conv(middle, outputs))

    def forward(self, x: Float[Tensor, "b c h w"], skip: Float[Tensor, "b d H W"]) -> Float[Tensor, "b e H W"]:
        size = (skip.shape[-2], skip.shape[-1])
        larger = F.interpolate(x, size, mode="bilinear", align_corners=True)
        joined: Tensor = self.convs(torch.cat((skip, larger), 1))
        return joined


def padded(x: Float[Tensor, "b c h w"], multiple: int) -> Float[Tensor, "b c H W"]:
    """The image with edge pixels repeated at the right and the bottom, to sizes that `multiple` divides."""
    height, width = x.shape[-2:]
    below, right = -height % multiple, -width % multiple
    return F.pad(x, (0, right, 0, below), mode="replicate") if below or right else x


def parameters(module: nn.Module) -> int:
    """How many numbers training changes."""
    return sum(p.numel() for p in module.parameters() if p.requires_grad)


def multiply_accumulates(module: nn.Module, run: Callable[[], object]) -> int:
    """Multiply-accumulate operations of all convolutions and linear layers of `module` while `run()` runs it.

    On the `meta` device this costs nothing, whatever the size. With gradients every layer is called for what it does:
    without them some are done together with others.
    """
    total = 0

    def count(layer: nn.Module, inputs: tuple[Any, ...], output: Any) -> None:
        nonlocal total
        if isinstance(layer, nn.ConvTranspose2d):
            total += inputs[0].numel() * layer.weight[0].numel()
        elif isinstance(layer, nn.Conv2d | nn.Linear):
            total += output.numel() * layer.weight[0].numel()

    hooks = [layer.register_forward_hook(count) for layer in module.modules()]
    try:
        with torch.enable_grad():
            run()
    finally:
        for hook in hooks:
            hook.remove()
    return total


def has_fast_bfloat16(device: torch.device | str) -> bool:
    """Whether networks run faster in bfloat16 there: GPUs from Ampere on, CPUs with matrix units for it."""
    if torch.device(device).type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    capabilities = torch.backends.cpu.get_cpu_capability()
    return torch.device(device).type == "cpu" and capabilities == "AVX512" and torch.cpu._is_amx_tile_supported()
