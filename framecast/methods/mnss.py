"""MNSS: a frame at twice its size from its samples and the last image, by networks small enough for phones.

Paper:   Yang, Zhao, Luo, Wang, Sun, Li, Cai, Jin, "MNSS: Neural Supersampling Framework for Real-Time Rendering on
         Mobile Devices", IEEE Transactions on Visualization and Computer Graphics 30(7), 2024,
         https://doi.org/10.1109/TVCG.2023.3259141
Follows: the stages of the published text: the last image and its depth reprojected, a network that maps how far they
         may be trusted and repairs them from the current frame, current samples made smooth with the history around
         them and put where they were taken, a blending network over the result. The layers are those of variant "B" of
         the authors' 2021 release: 9,908 parameters, all at display size (185 of them make the map), and one more
         convolution for the samples, 165.
Differs: Widths of the published network are not to be had, so those of 2021 stand in for them, at twice the
         size instead of three times.
         What was uncovered is asked of depth and vectors (`larger.unseen`) before the map is: there is no history.
         What stands still is the mean of the images that networks made of it, complete after two periods of the jitter;
         the recurrent network by itself goes on to change with every phase. Where frames come to differ from those that
         the mean is made of, it starts anew.
         Any jitter instead of a cycle over the display pixels: a sample covers the pixels around it by their distance.
         The map is a sigmoid, as in a public reimplementation; in 2021 it was a hyperbolic tangent.
         The blending network adds to the image that it sees. No enhancement network.
         History moves with the nearest surface around each pixel and is read from 4 x 4 pixels, which keeps it sharp.
         Colour is x / (1 + max), for networks under the sRGB curve; the release is not HDR. Nothing is clipped at 1.
         The loss is 1 - SSIM + 5 L1 of every frame, and 5 L1 of the smooth samples; VGG features are left out.
Needs:   color, depth, motion
Modes:   pass
State:   the last image and its depth, at display size; the frame's depth and vectors, and for how long it stood still
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from framecast.color import decode_srgb, encode_srgb, tonemap
from framecast.frame import Frame
from framecast.losses import difference
from framecast.methods.larger import WHITE, decoded, encoded, nearness, require, unseen, warn_of_stillness
from framecast.methods.mobfgsr import present
from framecast.methods.reproject import chosen, steps
from framecast.recipe import Recipe
from framecast.resample import (
    at_samples,
    centres,
    enlarge,
    enlarged_motion,
    foreground,
    moments,
    nearest_sample,
    phases,
    place,
    positions,
    size_at,
    tent,
)
from framecast.warp import inside, pick

TRUST = 2.0
"""What the map of trust starts from in training, before the sigmoid: 0.88."""

FRESH = 0.8
"""Weight of a new sample against the history around it, at the start of training."""

STILL = 1e-3
"""Motion in pixels of the frame below which a pixel stands still."""

CHANGED = 0.02
"""Difference as displayed, on smooth surfaces, from which on what stands still counts as changed."""


@dataclass(frozen=True)
class Config:
    """The network; the defaults are those of variant "B"."""

    scale: float = 2.0
    """Output size divided by input size."""
    inner: int = 16
    """Channels inside of the blocks."""
    joint: int = 8
    """Channels that the first block adds to what the second sees."""


@dataclass(frozen=True)
class Rest:
    """For how long the frame's pixels stood still. Colours are means of 3 x 3 pixels, which jitter hardly changes."""

    frames: Float[Tensor, "b 1 h w"]
    """Since the pixel moved or changed."""
    recent: Float[Tensor, "b 3 h w"]
    """Of about the last eight frames."""
    base: Float[Tensor, "b 3 h w"]
    """Of those that the image is made of."""


@dataclass(frozen=True)
class State:
    """The last image."""

    image: Float[Tensor, "b 4 H W"]
    """Tone-mapped colour, and depth as `nearness` encodes it."""
    rest: Rest
    depth: Float[Tensor, "b 1 h w"]
    motion: Float[Tensor, "b 2 h w"]
    time: Float[Tensor, " b"]
    jitter: Float[Tensor, "b 2"]
    known: Bool[Tensor, " b"]
    """False before the first frame."""


for _kind in (Rest, State):
    torch.export.register_dataclass(_kind)


@dataclass(frozen=True)
class Made:
    """What became of a frame."""

    image: Float[Tensor, "b 3 H W"]
    """Tone-mapped under the sRGB curve."""
    smooth: Float[Tensor, "b 3 h w"]
    """The frame's samples, made smooth with the history around them; tone-mapped."""
    depth: Float[Tensor, "b 1 H W"]
    """As `nearness` encodes it."""
    rest: Rest


def block(inputs: int, inner: int, outputs: int) -> nn.Sequential:
    """Three convolutions that see 17 x 17 pixels."""
    return nn.Sequential(
        nn.Conv2d(inputs, inner, 3, 1, 2, dilation=2),
        nn.ReLU(),
        nn.Conv2d(inner, inner, 3, 1, 5, dilation=5),
        nn.ReLU(),
        nn.Conv2d(inner, outputs, 3, 1, 1),
    )


class MNSS(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", "depth", "motion")
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("pass",)
    scales: tuple[float, ...] = (2.0,)
    parts: tuple[str, ...] = ("make",)
    history: int | None = None
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        self.trust = nn.Sequential(
            nn.Conv2d(4, 4, 3, 1, 1, padding_mode="replicate"),
            nn.ReLU(),
            nn.Conv2d(4, 1, 3, 1, 1, padding_mode="replicate"),
        )
        self.smooth = nn.Conv2d(6, 3, 3, 1, 1, padding_mode="replicate")
        self.first = nn.Sequential(block(8, config.inner, config.joint), nn.ReLU())
        self.second = block(8 + config.joint, config.inner, 3)
        with torch.no_grad():
            self.trust[2].bias.fill_(TRUST)  # type: ignore[operator]
            nn.init.zeros_(self.smooth.weight)
            nn.init.zeros_(self.smooth.bias)  # type: ignore[arg-type]
            for c in range(3):
                self.smooth.weight[c, c, 1, 1] += FRESH
                self.smooth.weight[c, c + 3, 1, 1] += 1 - FRESH
            nn.init.normal_(self.second[4].weight, std=1e-3)  # type: ignore[arg-type]
            nn.init.zeros_(self.second[4].bias)  # type: ignore[arg-type]

    def start(self, frame: Frame) -> State:
        """The state before the first frame, which is `frame`: nothing is known."""
        require(frame, "mnss", self.needs)
        assert frame.depth is not None
        size = size_at((frame.depth.shape[-2], frame.depth.shape[-1]), self.config.scale)
        image = frame.depth.new_zeros(frame.depth.shape[0], 4, *size)
        motion, depth = torch.zeros_like(present(frame.motion)), torch.ones_like(frame.depth)
        rest = Rest(torch.zeros_like(depth), *(torch.zeros_like(present(frame.color)) for _ in range(2)))
        return State(image, rest, depth, motion, frame.time, frame.jitter, torch.zeros_like(frame.reset))

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 H W"], State]:
        """The frame at display size, which is the next state.

        Raises:
            ValueError: the frame was not shaded, or its buffers are of different sizes.
        """
        require(frame, "mnss", self.needs)
        warn_of_stillness(torch.where(state.known[:, None], state.jitter, 1.0), frame.jitter, "mnss")
        made = self.make(frame, state)
        return decoded(made.image), kept(made, frame)

    def make(self, frame: Frame, state: State) -> Made:
        """The image and what it was made of."""
        assert frame.color is not None
        assert frame.depth is not None
        small, size = ((x.shape[-2], x.shape[-1]) for x in (frame.depth, state.image))
        with torch.autocast(frame.depth.device.type, enabled=False):
            seen = torch.cat((tonemap(frame.color).clamp(max=WHITE), nearness(frame.depth)), 1)
            current = enlarge(seen, size, frame.jitter, tent, 2).image
            history, known, still = moved(frame, state, size)
            rest, *counts = rested(state.rest, shown(seen)[:, :3], still, phases(self.config.scale))
            share, same = pick(torch.cat(counts, 1), nearest_sample(small, size, frame.jitter)).split(1, 1)
            before = shown(history)[:, :3]
        trust = torch.sigmoid(self.trust((shown(current) - shown(history)).abs()).float()) * known * same
        repaired = current + trust * (history - current)
        history = at_samples(repaired[:, :3], small, frame.jitter)
        smooth = self.smooth(torch.cat((seen[:, :3], history), 1)).float()
        with torch.autocast(frame.depth.device.type, enabled=False):
            samples = torch.cat((smooth, seen[:, 3:]), 1)
            values, cover = place(samples, positions(small, size, frame.jitter))
            canvas = shown(repaired + cover * (values - repaired))
        both = torch.cat((canvas, shown(current)), 1)
        added = self.second(torch.cat((both, self.first(both)), 1)).float()
        image = (1 - share) * before + share * (canvas[:, :3] + added)
        return Made(image, smooth, current[:, 3:], rest)


def kept(made: Made, frame: Frame) -> State:
    """What the next frame sees of an image."""
    image = decode_srgb(made.image.clamp(0, 1)).clamp(max=WHITE)
    motion, known = present(frame.motion), torch.ones_like(frame.reset)
    motion = chosen(frame.reset, torch.zeros_like(motion), motion)
    image = torch.cat((image, made.depth), 1)
    return State(image, made.rest, present(frame.depth), motion, frame.time, frame.jitter, known)


def moved(
    frame: Frame, state: State, size: tuple[int, int]
) -> tuple[Float[Tensor, "b 4 H W"], Float[Tensor, "b 1 H W"], Bool[Tensor, "b 1 h w"]]:
    """The last image where the frame shows its content, 1 where it showed that, and which small pixels stand still."""
    assert frame.depth is not None
    motion = steps(frame, state.time, frame.jitter)
    motion = chosen(frame.reset, torch.zeros_like(motion), motion)
    hidden = unseen(frame, motion, state.depth, state.motion, state.jitter)
    _, motion = foreground(frame.depth, motion)
    seen = inside(motion) & ~hidden & (state.known & ~frame.reset)[:, None, None, None]
    still = seen & (motion.abs().amax(1, keepdim=True) < STILL)
    nearest = nearest_sample((motion.shape[-2], motion.shape[-1]), size, frame.jitter)
    motion = enlarged_motion(motion, size, frame.jitter)
    across = torch.tensor([2 / size[1], 2 / size[0]], device=motion.device)
    grid = centres(size, motion.new_zeros(1, 2)) + motion.movedim(1, -1) * across
    image = F.grid_sample(state.image, grid, mode="bicubic", padding_mode="border", align_corners=False)
    known = pick(seen, nearest) & inside(motion)
    return torch.where(pick(still, nearest), state.image, image.clamp(0, WHITE)), known.float(), still


def rested(
    before: Rest, color: Float[Tensor, "b 3 h w"], still: Bool[Tensor, "b 1 h w"], period: int
) -> tuple[Rest, Float[Tensor, "b 1 h w"], Float[Tensor, "b 1 h w"]]:
    """How long pixels stand still with this frame, what its image counts against those before, 0 to 1, and 0 where
    their history is of another light, else 1.

    Args:
        color: of the frame, tone-mapped under the sRGB curve.
        still: pixels that show what they showed, and do not move.
        period: frames of the jitter.
    """
    mean, deviation = moments(color)
    recent = before.recent + (mean - before.recent) / (before.frames + 1).clamp(max=8)
    limit = CHANGED + deviation * (0.25 + 1 / (before.frames + 1))  # jitter moves means, those of few frames most
    same = ~still | ((recent - before.base).abs() < limit).all(1, keepdim=True)
    frames = torch.where(still & same, before.frames + 1, 0.0)
    share = (2 - frames / period).clamp(0, 1) * 2 / (frames + 2)
    rest = Rest(frames, torch.where(frames > 0, recent, mean), before.base + share * (mean - before.base))
    return rest, share, same.float()


def shown(image: Float[Tensor, "b 4 H W"]) -> Float[Tensor, "b 4 H W"]:
    """What networks see: tone-mapped colour under the sRGB curve, and depth."""
    return torch.cat((encode_srgb(image[:, :3].clamp(0, WHITE)), image[:, 3:]), 1)


# Training.


def loss(method: MNSS, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]) -> dict[str, Float[Tensor, ""]]:
    """Means over the frames: the two terms of the images, and the error of the samples made smooth."""
    state, terms = method.start(frames[0]), []
    for frame, target in zip(frames, targets.unbind(1), strict=True):
        made = method.make(frame, state)
        state = kept(made, frame)
        small = (made.smooth.shape[-2], made.smooth.shape[-1])
        truth = at_samples(tonemap(target).clamp(max=WHITE), small, frame.jitter)
        smooth = 5 * (encode_srgb(made.smooth.clamp(0, 1)) - encode_srgb(truth)).abs().mean()
        terms.append({**difference(made.image, encoded(target)), "smooth": smooth})
    return {name: torch.stack([each[name] for each in terms]).mean() for name in terms[0]}


recipe = Recipe(loss=loss, mode="pass", shaded=6, truths=6, crop=(64, 64), batch=2, steps=2000, rate=1e-3, warmup=50)
