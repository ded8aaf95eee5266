"""ExtraSS, the light that moves: a flow of demodulated light between the warps of the last two shaded frames.

Paper:   Wu, Vembar, Sochenov, Panneer, Kim, Kaplanyan, Yan, "ExtraSS: A Framework for Joint Spatial Super Sampling and
         Frame Extrapolation", SIGGRAPH Asia 2023 Conference Papers, https://doi.org/10.1145/3610548.3618224
Follows: section 4.2: the last two shaded frames, warped to the new one by its G-buffers (`guided.py`), so that what is
         left to move are shadows and reflections; at half size a small network ("FRNet") sees both and the roughness,
         and makes one flow that moves the newer one's light (Eq. 4); it is taken where base colour and normal are alike
         and where it differs (Eq. 5, 6); Charbonnier, census and census of features (Eq. 7 to 9).
Differs: The flow begins as one that is found without training (`matched`): coarse to fine, along it both lights agree,
         and better than they do where they are. The network adds to it. From a flow of zero it learned nothing in 600
         steps: where a shadow has moved by more than its edge is wide, no small change of the flow makes it better.
         What moves is light without texture: a shadow that crosses a floor leaves the tiles where they are.
         The flow is enlarged, not the image: the light at full size is read along it, so that nothing is blurred, and a
         flow of zero changes nothing. Likeness (Eq. 6) is asked between both ends of it.
         Light is taken to move evenly: at each of its sizes the network sees features of the newer frame read along the
         flow, and of the older one along the flow times how much longer ago it was, alike where the flow is right.
         In training shadows of our own making pass over the samples, for those of the scenes touch few pixels.
         Layers and widths are not published: four sizes of 16 to 48 channels and the residual blocks of IFRNet (Kong et
         al. 2022), whose coarse-to-fine form public re-implementations use.
Needs:   color, depth, motion, albedo, metallic, normal, roughness; of the generated frame the same but color
Modes:   extrapolate
State:   the last two shaded frames (light, surfaces) and the way from one to the other
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from framecast.color import decode_log, demodulate, encode_log, modulate
from framecast.frame import Frame
from framecast.losses import census, charbonnier
from framecast.methods.guided import Seen, after_cut, extrapolated, guides, require, seen
from framecast.methods.reproject import chosen, squared, steps, surface
from framecast.nets import padded
from framecast.recipe import Recipe
from framecast.warp import chain, inside, warp

BUFFERS = ("depth", "motion", "albedo", "metallic", "normal", "roughness")

ALIKE, UNLIKE = 0.1, 0.1
"""Likeness of surfaces, and relative difference of light, from which on moved light is taken: those of Eq. 6."""

SIDE = 16
"""Channels of the side branch in residual blocks."""

WINDOW = 9
"""Pixels at half size, and at each coarser one, over which two lights are compared."""

SIZES = 4
"""Sizes at which they are, each half of the last; every size adds a pixel at most: 15 at half size in all."""

FAR = 0.004
"""What a flow has to win, in the logarithm of light, for each of its pixels."""

SURE, LEAST = 0.7, 0.01
"""Part of what two lights differ by that may be left along the flow, and by how much they differ at least."""

FASTEST = 12.0
"""Pixels that a shadow of our own making moves between the newer frame and the new one, at most."""


@dataclass(frozen=True)
class Config:
    """The network."""

    scale: float = 1.0
    """Output size divided by input size."""
    network: bool = True
    """Without it the flow is the one that is found by matching."""
    widths: tuple[int, int, int, int] = (16, 24, 32, 48)
    """Channels at a quarter, an eighth, a sixteenth and a thirty-second of the frame."""


MATCHED = Config(network=False)
"""What needs no training."""


@dataclass(frozen=True)
class State:
    """The last two shaded frames."""

    newer: Seen
    older: Seen
    reach: Float[Tensor, "b 2 h w"]
    """Effective motion from the newer to the older."""
    depth: Float[Tensor, "b 1 h w"]
    """Of the newer."""
    known: Bool[Tensor, " b"]
    """Whether there is an older one of the same shot."""


torch.export.register_dataclass(State)


class Residual(nn.Module):
    """IFRNet's residual block: five convolutions, the second and fourth on a few channels alone."""

    def __init__(self, channels: int, side: int = SIDE) -> None:
        super().__init__()
        self.side = side
        self.convs = nn.ModuleList(nn.Conv2d(c, c, 3, 1, 1) for c in (channels, side, channels, side, channels))
        self.slopes = nn.ModuleList(nn.PReLU(c) for c in (channels, side, channels, side, channels))

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        found = x
        for k, (conv, slope) in enumerate(zip(self.convs, self.slopes, strict=True)):
            if k % 2:
                found = torch.cat((found[:, : -self.side], slope(conv(found[:, -self.side :]))), 1)
            elif k < 4:
                found = slope(conv(found))
        result: Tensor = self.slopes[4](x + self.convs[4](found))
        return result


def finer(inputs: int, inner: int, outputs: int) -> nn.Sequential:
    """Two channels of flow and features, at twice the size; untrained the flow is 0."""
    leave = nn.ConvTranspose2d(inner, 2 + outputs, 4, 2, 1)
    with torch.no_grad():
        assert leave.bias is not None
        leave.weight[:, :2].zero_()
        leave.bias[:2].zero_()
    return nn.Sequential(nn.Conv2d(inputs, inner, 3, 1, 1), nn.PReLU(inner), Residual(inner), leave)


class FRNet(nn.Module):
    """The flow of light, from coarse to fine."""

    def __init__(self, widths: tuple[int, int, int, int]) -> None:
        super().__init__()
        self.encoder = nn.ModuleList(
            nn.Sequential(nn.Conv2d(a, b, 3, 2, 1), nn.PReLU(b), nn.Conv2d(b, b, 3, 1, 1), nn.PReLU(b))
            for a, b in zip((4, *widths), widths, strict=False)
        )
        a, b, c, d = widths
        self.decoder = nn.ModuleList(
            (finer(2 * d, d, c), finer(3 * c + 2, d, b), finer(3 * b + 2, c, a), finer(3 * a + 2, c, 0))
        )

    def look(self, light: Float[Tensor, "b 3 h w"], roughness: Float[Tensor, "b 1 h w"]) -> list[Tensor]:
        """Features at four sizes, finest first."""
        x, found = torch.cat((light, roughness), 1), []
        for each in self.encoder:
            x = each(x)
            found.append(x)
        return found

    def forward(
        self,
        newer: Float[Tensor, "b 3 h w"],
        older: Float[Tensor, "b 3 h w"],
        roughness: Float[Tensor, "b 1 h w"],
        ratio: Float[Tensor, " b"],
        start: Float[Tensor, "b 2 h w"],
    ) -> tuple[Float[Tensor, "b 2 h w"], tuple[Tensor, ...]]:
        """The flow to where the newer light has what belongs here, in pixels, and the decoder's features at three
        sizes, coarsest first. Sizes have to be multiples of 16.

        Args:
            ratio: how long ago the older light was, divided by how long ago the newer was.
            start: the flow to which the network adds.
        """
        recent, past = self.look(newer, roughness), self.look(older, roughness)
        found = self.decoder[0](torch.cat((recent[3], past[3]), 1))
        added, features = found[:, :2].float(), [found[:, 2:]]
        for each, a, b in zip(self.decoder[1:], recent[2::-1], past[2::-1], strict=True):
            times = start.shape[-1] // a.shape[-1]
            flow = F.avg_pool2d(start, times) / times + added
            moved = shifted(a, flow), shifted(b, flow * ratio[:, None, None, None])
            found = each(torch.cat((*moved, features[-1], flow), 1))
            added = 2 * F.interpolate(added, scale_factor=2.0, mode="bilinear") + found[:, :2].float()
            features.append(found[:, 2:])
        return start + added, tuple(features[:3])


def shifted(image: Float[Tensor, "b c h w"], flow: Float[Tensor, "b 2 h w"]) -> Float[Tensor, "b c h w"]:
    """`warp.warp`, made for gradients through many channels; places are never rounded to the bits of the image."""
    height, width = image.shape[-2:]
    x = (torch.arange(width, device=flow.device) + 0.5 + flow[:, 0]) * (2 / width) - 1
    y = (torch.arange(height, device=flow.device)[:, None] + 0.5 + flow[:, 1]) * (2 / height) - 1
    grid = torch.stack((x, y), -1)
    return F.grid_sample(image.float(), grid, padding_mode="border", align_corners=False)


def matched(
    newer: Float[Tensor, "b 3 h w"],
    older: Float[Tensor, "b 3 h w"],
    known: Float[Tensor, "b 1 h w"],
    ratio: Float[Tensor, " b"],
) -> Float[Tensor, "b 2 h w"]:
    """The flow along which two lights agree, as in `FRNet`; 0 where it is not much better than none at all.

    Args:
        known: 1 where both lights were found, 0 where they were filled in.
    """
    sizes = [(newer, older, known)]
    for _ in range(SIZES - 1):
        a, b, c = (F.avg_pool2d(x, 2) for x in sizes[-1])
        sizes.append((a, b, c))
    flow = torch.zeros_like(sizes[-1][0][:, :2])
    for k, (a, b, c) in reversed(list(enumerate(sizes))):
        if flow.shape[-1] != a.shape[-1]:
            flow = 2 * F.interpolate(flow, scale_factor=2.0, mode="bilinear")
        best, least = torch.zeros_like(flow), disagreement(a, b, c, ratio, torch.zeros_like(flow))
        for y in (-1.0, 0.0, 1.0):
            for x in (-1.0, 0.0, 1.0):
                tried = flow + flow.new_tensor([x, y])[:, None, None]
                cost = disagreement(a, b, c, ratio, tried) + FAR * 2**k * squared(tried).sqrt()
                best, least = torch.where(cost < least, tried, best), torch.minimum(cost, least)
        flow = F.avg_pool2d(best, 3, 1, 1, count_include_pad=False)
    still = disagreement(newer, older, torch.ones_like(known), ratio, torch.zeros_like(flow))
    left = disagreement(newer, older, known, ratio, flow)  # beside what was not found no flow is sure
    return flow * ((left < SURE * still) & (still > LEAST))


def disagreement(
    newer: Float[Tensor, "b 3 h w"],
    older: Float[Tensor, "b 3 h w"],
    known: Float[Tensor, "b 1 h w"],
    ratio: Float[Tensor, " b"],
    flow: Float[Tensor, "b 2 h w"],
) -> Float[Tensor, "b 1 h w"]:
    """Mean difference of two lights along a flow around each pixel; 1 for what was not found."""
    further = flow * ratio[:, None, None, None]
    a, b = shifted(torch.cat((newer, known), 1), flow), shifted(torch.cat((older, known), 1), further)
    found = a[:, 3:] * b[:, 3:]
    apart = (a[:, :3] - b[:, :3]).abs().mean(1, keepdim=True) * found + (1 - found)
    return F.avg_pool2d(apart, WINDOW, 1, WINDOW // 2, count_include_pad=False)


class RefinedWarp(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", *BUFFERS)
    needs_generated: tuple[str, ...] = BUFFERS
    modes: tuple[str, ...] = ("extrapolate",)
    scales: tuple[float, ...] = (1.0,)
    parts: tuple[str, ...] = ("warped", "refine")
    history: int | None = 2
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        self.network = FRNet(config.widths) if config.network else None

    def start(self, frame: Frame) -> State:
        """The state before the first frame, which is `frame`: there is no older one.

        Raises:
            ValueError: a buffer is missing.
        """
        require(frame, "extrass-refined", self.needs, self.needs_generated)
        assert frame.depth is not None
        first, nowhere = seen(frame), torch.zeros_like(frame.depth).expand(-1, 2, -1, -1).contiguous()
        return State(first, first, nowhere, frame.depth, torch.zeros_like(frame.reset))

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 h w"], State]:
        """The frame's own image where it was shaded, else the light of the last one, moved on, on its surfaces.

        Raises:
            ValueError: a buffer is missing.
        """
        require(frame, "extrass-refined", self.needs, self.needs_generated)
        if frame.color is not None:
            return frame.color, followed(frame, state)
        newer = after_cut(frame, state.newer, "extrass-refined")
        state = State(newer, state.older, state.reach, state.depth, state.known & ~frame.reset)
        return modulate(decode_log(self.refine(frame, state, *self.warped(frame, state))), surface(frame)), state

    def warped(
        self, frame: Frame, state: State
    ) -> tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b 3 h w"], Float[Tensor, "b 1 h w"]]:
        """The light of the last two shaded frames on this frame's surfaces, encoded by `encode_log`; where there is
        only one, twice. And 1 where both were found."""
        assert frame.depth is not None
        with torch.no_grad(), torch.autocast(frame.depth.device.type, enabled=False):
            motion = steps(frame, state.newer.time, state.newer.jitter)
            spans = frame.time - state.newer.time, state.newer.time - state.older.time
            way = chain([motion, state.reach], [frame.depth, state.depth], spans)
            recent, known = extrapolated(frame, state.newer, motion=motion)
            past, known_then = extrapolated(frame, state.older, motion=way)
        return recent, chosen(state.known, past, recent), (known & known_then).float()

    def refine(
        self,
        frame: Frame,
        state: State,
        recent: Float[Tensor, "b 3 h w"],
        past: Float[Tensor, "b 3 h w"],
        known: Float[Tensor, "b 1 h w"],
    ) -> Float[Tensor, "b 3 h w"]:
        """The newer light, moved on."""
        flow, _, _ = self.flow(frame, state, recent, past, known)
        height, width = recent.shape[-2:]
        large = 2 * F.interpolate(flow, scale_factor=2.0, mode="bilinear")[..., :height, :width]
        return blended(recent, large * state.known[:, None, None, None], guides(frame)[:, :7])

    def flow(
        self,
        frame: Frame,
        state: State,
        recent: Float[Tensor, "b 3 h w"],
        past: Float[Tensor, "b 3 h w"],
        known: Float[Tensor, "b 1 h w"],
    ) -> tuple[Float[Tensor, "b 2 i j"], Float[Tensor, "b 3 i j"], tuple[Tensor, ...]]:
        """At half size, padded to multiples of 16: the flow, the newer light, and the decoder's features, if any."""
        assert frame.roughness is not None
        a, b, c, roughness = (padded(halved(x), 16) for x in (recent, past, known, frame.roughness))
        with torch.no_grad(), torch.autocast(a.device.type, enabled=False):
            start = matched(a, b, c, ago(frame, state))
        if self.network is None:
            return start, a, ()
        middle = a.mean((1, 2, 3), keepdim=True)
        flow, features = self.network(a - middle, b - middle, roughness, ago(frame, state), start)
        return flow, a, features


def ago(frame: Frame, state: State) -> Float[Tensor, " b"]:
    """How long ago the older frame was, divided by how long ago the newer was; within 1 and 8."""
    newer, older = ((frame.time - one.time).clamp(min=1e-3) for one in (state.newer, state.older))
    return (older / newer).clamp(1, 8)


def followed(frame: Frame, state: State) -> State:
    """The state after a shaded frame."""
    assert frame.depth is not None
    motion = steps(frame, state.newer.time, state.newer.jitter)
    earlier = (frame.time > state.newer.time) & ~frame.reset
    return State(seen(frame), state.newer, chosen(earlier, motion, torch.zeros_like(motion)), frame.depth, earlier)


def halved(image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c i j"]:
    """Every second pixel of every second row."""
    return image[..., ::2, ::2]


def blended(
    light: Float[Tensor, "b 3 h w"], flow: Float[Tensor, "b 2 h w"], surfaces: Float[Tensor, "b 7 h w"]
) -> Float[Tensor, "b 3 h w"]:
    """Light read along the flow where the surfaces at both ends are alike, and where it differs by enough (Eq. 5, 6).

    Args:
        light: encoded by `encode_log`.
        surfaces: base colour, normal and sky of `guided.guides`; the sky, whose normal is 0, is like nothing.
    """
    moved, there = warp(torch.cat((light, surfaces), 1), flow).split((3, 7), 1)
    likeness = 1 - (there[:, :3] - surfaces[:, :3]).square().sum(1, keepdim=True).sqrt() / math.sqrt(3)
    likeness = likeness * (there[:, 3:6] * surfaces[:, 3:6]).sum(1, keepdim=True)
    linear = decode_log(moved)
    change = (linear - decode_log(light)).abs().sum(1, keepdim=True) / (linear.sum(1, keepdim=True) + 1e-4)
    return torch.where((likeness > ALIKE) & (change > UNLIKE) & inside(flow), moved, light)


# Training.


def loss(
    method: RefinedWarp, frames: Sequence[Frame], targets: Float[Tensor, "b 1 3 h w"]
) -> dict[str, Float[Tensor, ""]]:
    """The three terms, of light at half size, for the last frame, over which shadows of our own making pass: those of
    the scenes touch few pixels, too few to learn flow from."""
    state = method.start(frames[0])
    for frame in frames[1:-1]:
        state = followed(frame, state)
    frame = frames[-1]
    assert frame.roughness is not None
    assert method.network is not None
    recent, past, known = method.warped(frame, state)
    ratio, size = ago(frame, state), (recent.shape[-2], recent.shape[-1])
    now, then, earlier = shadows(size, torch.stack((torch.zeros_like(ratio), torch.ones_like(ratio), ratio)), targets)
    flow, light, features = method.flow(frame, state, shaded(recent, then), shaded(past, earlier), known)
    truth = shaded(encode_log(demodulate(targets[:, -1], surface(frame))), now)
    truth, roughness = (padded(halved(x), 16) for x in (truth, frame.roughness))
    image = shifted(light, flow)
    seen_in_truth = method.network.look(truth - light.mean((1, 2, 3), keepdim=True), roughness)[2::-1]
    pairs = zip(features, seen_in_truth, strict=True)
    return {
        "charbonnier": charbonnier(image - truth),
        "census": census(image.mean(1, keepdim=True), truth.mean(1, keepdim=True)),
        "features": 0.001 * torch.stack([census(a.float(), b.float(), 3) for a, b in pairs]).sum(),
    }


def shadows(
    size: tuple[int, int], when: Float[Tensor, "n b"], sample: Float[Tensor, "b 1 3 h w"]
) -> Float[Tensor, "n b 1 h w"]:
    """What random soft shadows leave of the light, 0.1 to 1, at each of these times ago; they move evenly, up to
    `FASTEST` a unit of time. Numbers are drawn from the sample, so that a run that goes on draws them again."""
    draw = torch.Generator().manual_seed(int(sample.double().sum() * 1e3) % 2**31)
    batch, (height, width) = len(sample), size
    cells = torch.randn(batch, 1, height // 8, width // 8, generator=draw)
    angle, speed, sharp, dark = torch.rand(4, batch, generator=draw)
    velocity = FASTEST * speed.sqrt() * torch.stack((torch.cos(2 * math.pi * angle), torch.sin(2 * math.pi * angle)))
    y, x = torch.meshgrid(torch.linspace(-0.5, 0.5, height), torch.linspace(-0.5, 0.5, width), indexing="ij")
    found = []
    for ago in when.cpu():
        aside, down = (velocity * ago)[:, :, None, None]
        grid = torch.stack((x + aside / width, y + down / height), -1)
        noise = F.grid_sample(cells, grid, mode="bicubic", padding_mode="reflection", align_corners=False)
        cover = torch.sigmoid((noise - 0.3) * (4 + 16 * sharp[:, None, None, None]))
        found.append(1 - 0.9 * dark[:, None, None, None] * cover)
    return torch.stack(found).to(sample.device)


def shaded(light: Float[Tensor, "b 3 h w"], by: Float[Tensor, "b 1 h w"]) -> Float[Tensor, "b 3 h w"]:
    """Light, encoded by `encode_log`, of which a part is left."""
    return encode_log(decode_log(light) * by)


recipe = Recipe(loss=loss, mode="extrapolate", shaded=2, crop=(128, 128), batch=4, steps=1500, rate=1e-3, warmup=100)
