"""Classifier-guided supersampling: a network says why history fails, a small one mixes it with the frame accordingly.

Paper:   Guo, Chen, Dong, Tong, "Classifier Guided Temporal Supersampling for Real-time Rendering", Computer Graphics
         Forum 41(7), 2022, https://doi.org/10.1111/cgf.14672; networks, labels and buffers are in its supplement.
Follows: buffers at display size: the frame enlarged by cubics from its jittered samples, nearest depth, motion of the
         nearest surface in 3 x 3, frames since history failed, the last frame's range of colours, difference of
         reversed depths, the last classes. At half that size four scales of bottlenecks with 32, 64, 128 and 256
         channels, joined by depth-to-space to 32, three pixel-wise layers, two choices of three classes. A pixel-wise
         network of 64 gives the frame's weight against the history. Trained on `framecast.labels`.
Differs: Half of the features of a scale go on to the next; at the coarsest all are joined, or the sum were 30, not 32.
         Inside of a bottleneck, and in the decoder, as many channels as it makes; the supplement gives no others.
         What is carried and warped are likelihoods, which are bounded, and 1/3 each where nothing is known.
         One frame has one sample a pixel, so that the range of colours is that of 3 x 3 samples.
         The pixel-wise network sees likelihoods, frame, history and their difference, 1 / (1 + counter), difference of
         depths, confidence in the nearest sample, and by how much reading between pixels blurred the history. The
         supplement does not say; the last two are what an exact average of samples would ask for.
         Colour is x / (1 + max), for networks under the sRGB curve. The frame stays within the values of a tone map.
         Losses are not published. Here: 5 L1; L1 of the change from frame to frame where history holds; cross-entropy
         of both choices, each class weighted by 1 / sqrt(its share), between what finds rare classes (1 / share) and
         what is most often right (1). The classes also learn from the image.
         Off the screen and after a cut history fails whatever the network says.
Needs:   color, depth, motion
Modes:   pass
State:   the last image, its depth, counter, range of colours and classes, at display size
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from framecast.color import encode_srgb, tonemap, untonemap
from framecast.frame import Frame, inverse_depth
from framecast.methods.larger import WHITE, nearness, require, warn_of_stillness
from framecast.methods.reproject import chosen, steps
from framecast.nets import BatchNorm, padded
from framecast.recipe import Recipe
from framecast.resample import (
    catmull_rom,
    enlarge,
    enlarged_motion,
    foreground,
    gaussian,
    nearest_sample,
    neighbourhood,
    sharp_warp,
    size_at,
)
from framecast.warp import fetch, inside, pick, warp

CLASSES = 6
"""Ghosting: visibility, shading, none; aliasing: geometry, texture, none."""

LONG = 16.0
"""Motion in display pixels that networks see as 1."""

OLD = -1.5
"""What the weight of the frame starts from in training, before the sigmoid: 0.18."""

SHARES = {"ghosting": (0.015, 0.005, 0.98), "aliasing": (0.13, 0.16, 0.71)}
"""About how many pixels of the training clips are of each class."""


@dataclass(frozen=True)
class Config:
    """The networks; the defaults are the published ones."""

    scale: float = 2.0
    """Output size divided by input size."""
    widths: tuple[int, int, int, int] = (32, 64, 128, 256)
    """Channels of the four scales, multiples of 2, 8, 32 and 64."""
    inner: int = 64
    """Channels inside of the network that mixes."""
    counter: bool = True
    """Show how many frames history is made of."""
    carried: bool = True
    """Show the classes of the last frame."""
    range: bool = True
    """Show the range of colours of the last frame."""
    classifier: bool = True
    """Tell the network that mixes the classes; without, history starts anew only off the screen and after a cut."""


@dataclass(frozen=True)
class State:
    """The last frame, at display size."""

    image: Float[Tensor, "b 3 H W"]
    """Tone-mapped."""
    depth: Float[Tensor, "b 1 H W"]
    """Reversed: 1 / depth, 0 at the sky."""
    counter: Float[Tensor, "b 1 H W"]
    """Frames before it that the image is made of."""
    range: Float[Tensor, "b 6 H W"]
    """Smallest and largest tone-mapped colour, under the sRGB curve."""
    classes: Float[Tensor, "b 6 H W"]
    """Likelihoods, in the order of `CLASSES`; 1/3 each: nothing is known."""
    time: Float[Tensor, " b"]
    jitter: Float[Tensor, "b 2"]
    known: Bool[Tensor, " b"]
    """False before the first frame."""


torch.export.register_dataclass(State)


@dataclass(frozen=True)
class Seen:
    """A frame and what is known of the last one at its places; where nothing is, the frame itself stands in."""

    current: Float[Tensor, "b 3 H W"]
    """Tone-mapped."""
    history: Float[Tensor, "b 3 H W"]
    """Tone-mapped."""
    valid: Bool[Tensor, "b 1 H W"]
    """Where there is history at all."""
    motion: Float[Tensor, "b 2 H W"]
    """To the last frame, display pixels; 0 where not valid."""
    depth: Float[Tensor, "b 1 H W"]
    """Reversed."""
    nearness: Float[Tensor, "b 1 H W"]
    """Depth for networks."""
    difference: Float[Tensor, "b 1 H W"]
    """Reversed depth there less that here, relative to the larger: above 0 something nearer was there."""
    counter: Float[Tensor, "b 1 H W"]
    """Of the last frame."""
    range: Float[Tensor, "b 6 H W"]
    """Of the last frame."""
    range_now: Float[Tensor, "b 6 H W"]
    classes: Float[Tensor, "b 6 H W"]
    """Of the last frame."""
    confidence: Float[Tensor, "b 1 H W"]
    """1 where a sample of the frame lies on the pixel's centre, falling with its distance."""
    blur: Float[Tensor, "b 1 H W"]
    """0 where history was read on the centre of a pixel, 1 half-way between pixels in both directions."""


@dataclass(frozen=True)
class Made:
    """What became of a frame."""

    image: Float[Tensor, "b 3 H W"]
    """Tone-mapped."""
    logits: Float[Tensor, "b 6 H W"] | None
    """Of the classes; None without a classifier."""
    classes: Float[Tensor, "b 6 H W"]
    """Likelihoods that the image was made with."""
    counter: Float[Tensor, "b 1 H W"]
    seen: Seen


def bottleneck(inputs: int, channels: int) -> nn.Sequential:
    """Pixel-wise, 3 x 3 within each channel, pixel-wise."""
    return nn.Sequential(
        *pixelwise(inputs, channels),
        nn.Conv2d(channels, channels, 3, 1, 1, groups=channels),
        *pixelwise(channels, channels),
    )


def pixelwise(inputs: int, outputs: int) -> tuple[nn.Conv2d, BatchNorm, nn.ReLU]:
    """1 x 1 convolution, normalisation, rectifier."""
    return nn.Conv2d(inputs, outputs, 1), BatchNorm(outputs), nn.ReLU()


class Network(nn.Module):
    """The classifier: buffers at half the display size, whose sides are multiples of 8, to logits of that size."""

    def __init__(self, inputs: int, widths: tuple[int, int, int, int]) -> None:
        super().__init__()
        entering = (inputs, *(width // 2 for width in widths[:-1]))
        self.blocks = nn.ModuleList(bottleneck(a, b) for a, b in zip(entering, widths, strict=True))
        joined = widths[0] // 2 + widths[1] // 8 + widths[2] // 32 + widths[3] // 64
        self.decode = nn.Sequential(
            *(layer for _ in range(3) for layer in pixelwise(joined, joined)),
            nn.Conv2d(joined, CLASSES, 1),
            BatchNorm(CLASSES),
        )

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 6 h w"]:
        logits: Tensor = self.decode(self.joined(x))
        return logits

    def joined(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h w"]:
        """Features of all scales at the size of the first; 32 of them with the published widths."""
        features = []
        for k, block in enumerate(self.blocks):
            x = block(F.max_pool2d(x, 2) if k else x)
            mine, x = (x, x) if block is self.blocks[-1] else x.chunk(2, 1)
            features.append(F.pixel_shuffle(mine, 2**k))
        return torch.cat(features, 1)


class Classifier(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", "depth", "motion")
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("pass",)
    scales: tuple[float, ...] = (1.5, 2.0, 3.0)
    parts: tuple[str, ...] = ("make",)
    history: int | None = None
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        inputs = 10 + config.counter + 6 * config.range + CLASSES * config.carried
        self.classify = Network(4 * inputs, config.widths) if config.classifier else None
        mixed = 12 + config.counter + CLASSES * config.classifier
        self.mix = nn.Sequential(nn.Conv2d(mixed, config.inner, 1), nn.ReLU(), nn.Conv2d(config.inner, 1, 1))
        nn.init.constant_(self.mix[2].bias, OLD)  # type: ignore[arg-type]

    def start(self, frame: Frame) -> State:
        """The state before the first frame, which is `frame`: nothing is known."""
        require(frame, "classifier", self.needs)
        assert frame.depth is not None
        size = size_at((frame.depth.shape[-2], frame.depth.shape[-1]), self.config.scale)
        image, depth, counter, span = (frame.depth.new_zeros(len(frame.depth), c, *size) for c in (3, 1, 1, 6))
        nothing = torch.full_like(span, 1 / 3)
        return State(image, depth, counter, span, nothing, frame.time, frame.jitter, torch.zeros_like(frame.reset))

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 H W"], State]:
        """The frame at display size, and what is known of it.

        Raises:
            ValueError: the frame was not shaded, or its buffers are of different sizes.
        """
        require(frame, "classifier", self.needs)
        warn_of_stillness(torch.where(state.known[:, None], state.jitter, 1.0), frame.jitter, "classifier")
        made = self.make(frame, state)
        return untonemap(made.image), kept(made, frame)

    def make(self, frame: Frame, state: State, truth: Float[Tensor, "b 2 H W"] | None = None) -> Made:
        """The image and what it was made of.

        Args:
            truth: true classes (indices into `labels.GHOSTING` and `labels.ALIASING`) to take in place of the
                network's.
        """
        seen = self.look(frame, state)
        logits = self.logits(seen)
        with torch.autocast(frame.time.device.type, enabled=False):
            classes = seen.classes if logits is None else likelihoods(logits)
            if truth is not None:
                classes = torch.cat([one_hot(truth[:, k]) for k in (0, 1)], 1)
            failed = classes[:, :1] > classes[:, 1:3].amax(1, keepdim=True)
            counter = torch.where(failed | ~seen.valid, 0.0, seen.counter + 1)
        weight = torch.sigmoid(self.mix(self.mixing(seen, classes, counter)).float())
        image = seen.history + weight * (seen.current - seen.history)
        return Made(image, logits, classes, counter, seen)

    def look(self, frame: Frame, state: State) -> Seen:
        """The auxiliary buffers."""
        with torch.autocast(frame.time.device.type, enabled=False):
            return look(frame, state, self.config.scale)

    def logits(self, seen: Seen) -> Float[Tensor, "b 6 H W"] | None:
        """What the classifier says, enlarged to display size."""
        if self.classify is None:
            return None
        c, (height, width) = self.config, seen.depth.shape[-2:]
        shown = [encode_srgb(seen.current), encode_srgb(seen.history), seen.nearness, seen.difference]
        shown.append((seen.motion / LONG).clamp(-4, 4))
        shown += [1 / (1 + seen.counter)] * c.counter + [seen.range] * c.range + [seen.classes] * c.carried
        half: Tensor = self.classify(F.pixel_unshuffle(padded(torch.cat(shown, 1), 16), 2))
        return F.interpolate(half.float(), scale_factor=2, mode="bilinear")[..., :height, :width]

    def mixing(self, seen: Seen, classes: Tensor, counter: Tensor) -> Float[Tensor, "b c H W"]:
        """What the network that mixes sees."""
        current, history = encode_srgb(seen.current), encode_srgb(seen.history)
        shown = [current, history, (current - history).abs(), seen.difference, seen.confidence, seen.blur]
        shown += [1 / (1 + counter)] * self.config.counter + [classes] * self.config.classifier
        return torch.cat(shown, 1)


def look(frame: Frame, state: State, scale: float) -> Seen:
    """The auxiliary buffers of a frame, at display size."""
    assert frame.color is not None
    assert frame.depth is not None
    small, size = ((x.shape[-2], x.shape[-1]) for x in (frame.depth, state.image))
    color, jitter = tonemap(frame.color).clamp(max=WHITE), frame.jitter
    nearest = nearest_sample(small, size, jitter)
    around = neighbourhood(encode_srgb(color))
    depths = torch.cat((frame.depth, around.low, around.high), 1)
    depth, range_now = pick(depths, nearest).split((1, 6), 1)
    motion = steps(frame, state.time, jitter)  # both images lie on whole pixels: their jitter is the same
    motion = foreground(frame.depth, chosen(frame.reset, torch.zeros_like(motion), motion))[1]
    motion = enlarged_motion(motion, size, jitter)
    valid = inside(motion) & (state.known & ~frame.reset)[:, None, None, None]
    motion = torch.where(valid, motion, 0.0)
    current = enlarge(color, size, jitter, catmull_rom, 4).image.clamp(0, WHITE)
    there, counter, range_there = fetch(torch.cat((state.depth, state.counter, state.range), 1), motion).split(
        (1, 1, 6), 1
    )
    here = inverse_depth(depth)
    difference = (there - here) / torch.maximum(there, here).clamp(min=1e-6)
    fraction = motion - motion.floor()
    return Seen(
        current=current,
        history=torch.where(valid, sharp_warp(state.image, motion), current),
        valid=valid,
        motion=motion,
        depth=here,
        nearness=nearness(depth),
        difference=torch.where(valid, difference, 0.0),
        counter=torch.where(valid, counter, 0.0),
        range=torch.where(valid, range_there, range_now),
        range_now=range_now,
        classes=torch.where(valid, warp(state.classes, motion), 1 / 3),
        confidence=enlarge(frame.depth, size, jitter, lambda x: gaussian(scale * x), 3).peak,
        blur=2 * (fraction * (1 - fraction)).sum(1, keepdim=True),
    )


def likelihoods(logits: Float[Tensor, "b 6 H W"]) -> Float[Tensor, "b 6 H W"]:
    """Of the three classes of ghosting and of the three of aliasing."""
    return torch.cat([torch.softmax(three, 1) for three in logits.chunk(2, 1)], 1)


def one_hot(classes: Float[Tensor, "b H W"]) -> Float[Tensor, "b 3 H W"]:
    """1 in the plane of each pixel's class."""
    return torch.stack([(classes == k).float() for k in range(3)], 1)


def kept(made: Made, frame: Frame) -> State:
    """What the next frame sees of this one."""
    seen, known = made.seen, torch.ones_like(frame.reset)
    return State(made.image, seen.depth, made.counter, seen.range_now, made.classes, frame.time, frame.jitter, known)


# Training.


def loss(
    method: Classifier, frames: Sequence[Frame], targets: Float[Tensor, "b n 5 H W"], *, true_labels: bool = False
) -> dict[str, Float[Tensor, ""]]:
    """Means over the frames that have truth: its colour, and its classes as two channels.

    Args:
        true_labels: mix with the true classes in place of the network's, which learns all the same.
    """
    first = len(frames) - targets.shape[1]
    state, before, terms = method.start(frames[0]), None, []
    for frame, target in zip(frames, (*[None] * first, *targets.unbind(1)), strict=True):
        made = method.make(frame, state, None if target is None or not true_labels else target[:, 3:])
        if target is not None:
            terms.append(errors(made, target, before))
            before = tonemap(target[:, :3]).clamp(max=WHITE)
        state = kept(made, frame)
    names = dict.fromkeys(name for each in terms for name in each)
    return {name: torch.stack([each[name] for each in terms if name in each]).mean() for name in names}


def loss_with_true_labels(
    method: Classifier, frames: Sequence[Frame], targets: Float[Tensor, "b n 5 H W"]
) -> dict[str, Float[Tensor, ""]]:
    """`loss`, the image made with the true classes."""
    return loss(method, frames, targets, true_labels=True)


def errors(
    made: Made, target: Float[Tensor, "b 5 H W"], before: Float[Tensor, "b 3 H W"] | None
) -> dict[str, Float[Tensor, ""]]:
    """The terms of one frame; `before` is the tone-mapped truth of the last one."""
    truth, classes = tonemap(target[:, :3]).clamp(max=WHITE), target[:, 3:].long()
    seen = made.seen
    terms = {"l1": 5 * (encode_srgb(made.image) - encode_srgb(truth)).abs().mean()}
    if before is not None:
        holds = (seen.valid & (classes[:, :1] == 2)).float()
        change = encode_srgb(made.image) - encode_srgb(seen.history)
        right = encode_srgb(truth) - encode_srgb(sharp_warp(before, seen.motion))
        terms["temporal"] = (holds * (change - right).abs()).mean()
    if made.logits is not None:
        for k, (name, shares) in enumerate(SHARES.items()):
            weights = torch.tensor(shares, device=truth.device).rsqrt()
            logits = made.logits[:, 3 * k : 3 * k + 3]
            terms[name] = 0.1 * F.cross_entropy(logits, classes[:, k], weights)
    return terms


recipe = Recipe(
    loss=loss, mode="pass", shaded=6, truths=5, labels=True, crop=(64, 64), batch=2, steps=3000, rate=1e-3, warmup=50
)
