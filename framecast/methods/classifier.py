"""Classifier-guided supersampling: a network says why history fails, a small one mixes it with the frame accordingly.

Paper:   Guo, Chen, Dong, Tong, "Classifier Guided Temporal Supersampling for Real-time Rendering", Computer Graphics
         Forum 41(7), 2022, https://doi.org/10.1111/cgf.14672; networks, labels and buffers are in its supplement.
Follows: buffers at display size: the frame enlarged by cubics from its jittered samples, nearest depth, motion of the
         nearest surface in 3 x 3, frames since history failed, the last frame's range of colours, difference of
         reversed depths, the last classes. At half that size four scales of bottlenecks with 32, 64, 128 and 256
         channels, joined by depth-to-space to 32, three pixel-wise layers, two choices of three classes. A pixel-wise
         network of 64 channels weighs the frame against the history. Trained on `framecast.labels`.
Differs: Half of the features of a scale go on to the next; at the coarsest all are joined, or the sum were 30, not 32.
         Inside of a bottleneck, and in the decoder, as many channels as it makes; the supplement gives no others.
         What is carried and warped are likelihoods, which are bounded, and 1/3 each where nothing is known.
         One frame has one sample a pixel, so that the range of colours is that of 3 x 3 samples.
         The weight of the frame is not made from nothing. An image is worth the samples that it is the mean of, as in
         TAAU, each by its distance to the centre of the pixel; the network says how far history is still worth that,
         and how much more or less the frame is. Untrained, it accumulates as TAAU does. Where the classifier is sure
         that history shows what hid the surface, it is worth next to nothing.
         The network also says how far history has to lie within the colours of the 3 x 3 samples, how sharp the frame
         is enlarged, and how far the image, after what is kept of it, goes towards each of the 8 pixels around it, or
         away from them: the mean of samples is less sharp than a display pixel.
         What stands still is complete after two periods of the jitter and stays as it then is, until the classifier
         says that history fails, or squares of 8 x 8 pixels have become brighter or darker than it.
         The network sees likelihoods, frame, history and their difference and slopes, what the bounds take away,
         detail, speed, counter and worth, difference of depths, distance of the sample, how much reading blurred the
         history, and 8 channels that the classifier makes beside the classes.
         Colour is x / (1 + max), for networks under the sRGB curve.
         Losses are not published. Here: 5 times the root of the mean square error as displayed, where pixels whose
         history fails count threefold; L1 of the change from image to image where it holds; half the cross-entropy
         of both choices, each class weighted by 1 / sqrt(its share), between what finds rare classes (1 / share) and
         what is most often right (1). The classes also learn from the image.
         Off the screen and after a cut history fails whatever the network says.
         Not for three times the size: what is learnt at twice does not come to rest there on a still picture.
Needs:   color, depth, motion
Modes:   pass
State:   what was accumulated, its worth, depth, counter, range of colours, classes and rest, at display size
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from framecast.color import to_display, untonemap
from framecast.frame import Frame
from framecast.methods.classifier_buffers import BLOCK, CLASSES, Rest, Seen, State, look, rested
from framecast.methods.larger import AROUND, WHITE, require, sharpened, warn_of_stillness
from framecast.nets import BatchNorm, padded
from framecast.recipe import Recipe
from framecast.resample import phases, size_at
from framecast.warp import warp

LONG = 16.0
"""Motion in display pixels that networks see as 1."""

FIRST, MOST = 0.05, 64.0
"""Least and most that an image can be worth; a sample on the centre of a pixel is worth 1."""
STEADY = 4.0
"""What all history is worth where nothing is counted."""
RANGE = 2.0
"""The network makes samples worth up to this many factors e more or less."""
KEEP = 4.0
"""What the network's trust in history starts from in training, before the sigmoid: 0.98."""
HIDDEN = 8.0
"""By how much, before that sigmoid, trust is less where history surely shows what hid the surface."""
GHOSTED = 3.0
"""What a pixel where history fails counts in the loss, against one where it holds."""
CLASSES_COUNT = 0.5
"""What finding classes counts in the loss."""

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
    guide: int = 8
    """What the classifier tells the network that mixes beside the classes, channels."""
    counter: bool = True
    """Show how many frames history is made of, and weigh it by its samples."""
    carried: bool = True
    """Show the classes of the last frame."""
    range: bool = True
    """Show the range of colours of the last frame."""
    classifier: bool = True
    """Tell the network that mixes the classes."""


@dataclass(frozen=True)
class Mixed:
    """What the network that mixes made of a frame and history."""

    image: Float[Tensor, "b 3 H W"]
    """Tone-mapped."""
    kept: Float[Tensor, "b 3 H W"]
    """The same before it was sharpened, for the next frame."""
    worth: Float[Tensor, "b 1 H W"]
    """Samples that it is made of."""


@dataclass(frozen=True)
class Made:
    """What became of a frame."""

    mixed: Mixed
    logits: Float[Tensor, "b 6 H W"] | None
    """Of the classes; None without a classifier."""
    classes: Float[Tensor, "b 6 H W"]
    """Likelihoods that the image was made with."""
    counter: Float[Tensor, "b 1 H W"]
    rest: Rest
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
    """The classifier: buffers at half the display size, whose sides are multiples of 8, to logits of that size.

    After them comes what it tells the network that mixes beside them.
    """

    def __init__(self, inputs: int, widths: tuple[int, int, int, int], guide: int) -> None:
        super().__init__()
        entering = (inputs, *(width // 2 for width in widths[:-1]))
        self.blocks = nn.ModuleList(bottleneck(a, b) for a, b in zip(entering, widths, strict=True))
        joined = widths[0] // 2 + widths[1] // 8 + widths[2] // 32 + widths[3] // 64
        self.decode = nn.Sequential(
            *(layer for _ in range(3) for layer in pixelwise(joined, joined)),
            nn.Conv2d(joined, CLASSES + guide, 1),
            BatchNorm(CLASSES + guide),
        )
        shares = torch.tensor([share for three in SHARES.values() for share in three])
        with torch.no_grad():
            self.decode[-1].bias[:CLASSES] = shares.log() / 2  # type: ignore[operator]

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h w"]:
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
    scales: tuple[float, ...] = (1.5, 2.0)
    parts: tuple[str, ...] = ("look", "classified", "mixing", "mixed")
    history: int | None = None
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        inputs = 10 + config.counter + 6 * config.range + CLASSES * config.carried
        self.classify = Network(4 * inputs, config.widths, config.guide) if config.classifier else None
        mixed = 19 + 2 * config.counter + (CLASSES + config.guide) * config.classifier
        outputs = 4 + len(AROUND)
        self.mix = nn.Sequential(nn.Conv2d(mixed, config.inner, 1), nn.ReLU(), nn.Conv2d(config.inner, outputs, 1))
        # The first images are, nearly, means of samples.
        nn.init.normal_(self.mix[2].weight, std=1e-2)  # type: ignore[arg-type]
        with torch.no_grad():
            self.mix[2].bias.copy_(torch.tensor([KEEP] + [0.0] * (outputs - 1)))  # type: ignore[operator]

    def start(self, frame: Frame) -> State:
        """The state before the first frame, which is `frame`: nothing is known."""
        require(frame, "classifier", self.needs)
        assert frame.depth is not None
        size = size_at((frame.depth.shape[-2], frame.depth.shape[-1]), self.config.scale)
        image, one, span = (frame.depth.new_zeros(len(frame.depth), c, *size) for c in (3, 1, 6))
        nothing, known = torch.full_like(span, 1 / 3), torch.zeros_like(frame.reset)
        drift = image.new_zeros(len(image), 3, *(-(-side // BLOCK) for side in size))
        rest = Rest(one, drift)
        return State(image, one.clone(), one.clone(), one.clone(), span, nothing, rest, frame.time, frame.jitter, known)

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 H W"], State]:
        """The frame at display size, and what is known of it.

        Raises:
            ValueError: the frame was not shaded, or its buffers are of different sizes.
        """
        require(frame, "classifier", self.needs)
        warn_of_stillness(torch.where(state.known[:, None], state.jitter, 1.0), frame.jitter, "classifier")
        made = self.make(frame, state)
        return untonemap(made.mixed.image), kept(made, frame)

    def make(self, frame: Frame, state: State, truth: Float[Tensor, "b 2 H W"] | None = None) -> Made:
        """The image and what it was made of.

        Args:
            truth: true classes (indices into `labels.GHOSTING` and `labels.ALIASING`) to take in place of the
                network's.
        """
        seen = self.look(frame, state)
        logits, guide = self.classified(seen)
        with torch.autocast(frame.time.device.type, enabled=False):
            classes = seen.classes if logits is None else likelihoods(logits)
            if truth is not None:
                classes = torch.cat([one_hot(truth[:, k]) for k in (0, 1)], 1)
            failed = classes[:, :1] > classes[:, 1:3].amax(1, keepdim=True)
            counter = torch.where(failed | ~seen.valid, 0.0, seen.counter + 1)
            ghost = classes[:, :2].amax(1, keepdim=True) > classes[:, 2:3]
            rest = rested(seen, state.rest, ghost, frame.reset | ~state.known)
            hidden = classes[:, :1] * self.config.classifier
        mixed = self.mixed(seen, self.mixing(seen, classes, counter, guide), hidden, rest)
        return Made(mixed, logits, classes, counter, rest, seen)

    def look(self, frame: Frame, state: State) -> Seen:
        """The auxiliary buffers."""
        with torch.autocast(frame.time.device.type, enabled=False):
            seen = look(frame, state, self.config.scale)
        return seen if self.config.counter else replace(seen, worth=torch.where(seen.valid, STEADY, 0.0))

    def classified(self, seen: Seen) -> tuple[Float[Tensor, "b 6 H W"] | None, Float[Tensor, "b g H W"] | None]:
        """What the classifier says of the classes, as logits, and beside them; enlarged to display size."""
        if self.classify is None:
            return None, None
        c, (height, width) = self.config, seen.depth.shape[-2:]
        shown = [seen.shown, seen.nearness, seen.difference, (seen.motion / LONG).clamp(-4, 4)]
        shown += [1 / (1 + seen.counter)] * c.counter + [seen.range] * c.range + [seen.classes] * c.carried
        half: Tensor = self.classify(F.pixel_unshuffle(padded(torch.cat(shown, 1), 16), 2))
        large = F.interpolate(half.float(), scale_factor=2, mode="bilinear")[..., :height, :width]
        return large[:, :CLASSES], large[:, CLASSES:]

    def mixing(self, seen: Seen, classes: Tensor, counter: Tensor, guide: Tensor | None) -> Float[Tensor, "b c H W"]:
        """What the network that mixes sees."""
        current, history = seen.shown.chunk(2, 1)
        off = (seen.bounded - seen.history).abs().amax(1, keepdim=True)
        detail = (seen.sharp - seen.smooth).abs().amax(1, keepdim=True)
        speed = (seen.motion / LONG).square().sum(1, keepdim=True).sqrt().clamp(max=4)
        shown = [current, history, (current - history).abs(), 4 * off, 4 * detail, speed]
        shown += [seen.difference, seen.confidence, seen.blur, slopes(current), slopes(history)]
        shown += [1 / (1 + counter), 1 / (1 + seen.worth)] * self.config.counter
        shown += [] if guide is None else [classes, guide]
        return torch.cat(shown, 1)

    def mixed(self, seen: Seen, shown: Float[Tensor, "b c H W"], hidden: Float[Tensor, "b 1 H W"], rest: Rest) -> Mixed:
        """What the network that mixes makes of what it is shown."""
        raw = self.mix(shown).float()
        with torch.autocast(seen.depth.device.type, enabled=False):
            unsettled = (2 - rest.frames / phases(self.config.scale)).clamp(0, 1)
            return mix(seen, raw, hidden, unsettled)


def slopes(image: Float[Tensor, "b 3 H W"]) -> Float[Tensor, "b 2 H W"]:
    """How brightness changes across and down, from the pixel before to the one after."""
    bright = F.pad(image.mean(1, keepdim=True), (1, 1, 1, 1), mode="replicate")
    across, down = bright[..., 1:-1, 2:] - bright[..., 1:-1, :-2], bright[..., 2:, 1:-1] - bright[..., :-2, 1:-1]
    return torch.cat((across, down), 1)


def mix(
    seen: Seen,
    raw: Float[Tensor, "b 12 H W"],
    hidden: Float[Tensor, "b 1 H W"],
    unsettled: Float[Tensor, "b 1 H W"],
) -> Mixed:
    """Frame and history, each by the samples that it is worth, as far as the network does not say otherwise.

    Args:
        raw: how far history is still worth what it was; how much more or less the frame is; how far history has to
            lie within the frame's colours; how sharp the frame is; and, for the image alone, how far it goes towards
            each of the pixels around (`AROUND`), or away from them.
        hidden: likelihood that history shows what hid the surface.
        unsettled: 1, falling to 0 where nothing changes any more: history is exact there, and the image is what it was.
    """
    trust, fresh, bound, sharp, taps = raw.split((1, 1, 1, 1, len(AROUND)), 1)
    old = seen.worth * torch.sigmoid(trust - HIDDEN * hidden)
    new = seen.confidence * torch.exp(RANGE * torch.tanh(fresh)) * unsettled
    current = seen.smooth + torch.sigmoid(sharp) * (seen.sharp - seen.smooth)
    history = seen.history + torch.sigmoid(bound) * unsettled * (seen.bounded - seen.history)
    share = torch.where(seen.worth > 0, new / (old + new).clamp(min=1e-6), 1.0)
    kept = history + share * (current - history)
    image = (kept + unsettled * sharpened(kept, taps)).clamp(0, WHITE)
    return Mixed(image, kept, (old + new).clamp(FIRST, MOST))


def likelihoods(logits: Float[Tensor, "b 6 H W"]) -> Float[Tensor, "b 6 H W"]:
    """Of the three classes of ghosting and of the three of aliasing."""
    return torch.cat([torch.softmax(three, 1) for three in logits.chunk(2, 1)], 1)


def one_hot(classes: Float[Tensor, "b H W"]) -> Float[Tensor, "b 3 H W"]:
    """1 in the plane of each pixel's class."""
    return torch.stack([(classes == k).float() for k in range(3)], 1)


def kept(made: Made, frame: Frame) -> State:
    """What the next frame sees of this one."""
    seen, mixed, known = made.seen, made.mixed, torch.ones_like(frame.reset)
    return State(
        mixed.kept,
        mixed.worth,
        seen.depth,
        made.counter,
        seen.range_now,
        made.classes,
        made.rest,
        frame.time,
        frame.jitter,
        known,
    )


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
            before = displayed(made, target)
        state = kept(made, frame)
    names = dict.fromkeys(name for each in terms for name in each)
    return {name: torch.stack([each[name] for each in terms if name in each]).mean() for name in names}


def loss_with_true_labels(
    method: Classifier, frames: Sequence[Frame], targets: Float[Tensor, "b n 5 H W"]
) -> dict[str, Float[Tensor, ""]]:
    """`loss`, the image made with the true classes."""
    return loss(method, frames, targets, true_labels=True)


def errors(
    made: Made, target: Float[Tensor, "b 5 H W"], before: Float[Tensor, "b 6 H W"] | None
) -> dict[str, Float[Tensor, ""]]:
    """The terms of one frame; `before` is the last image beside its truth, as displayed."""
    classes, seen, both = target[:, 3:].long(), made.seen, displayed(made, target)
    off = both[:, :3] - both[:, 3:]
    weight = torch.where(classes[:, :1] == 2, 1.0, GHOSTED)
    square = (weight * off.square()).mean((1, 2, 3)) / weight.mean((1, 2, 3))
    terms = {"image": 5 * (square + 1e-6).sqrt().mean()}
    if before is not None:
        holds = (seen.valid & (classes[:, :1] == 2)).float()
        old = warp(before, seen.motion)
        terms["temporal"] = (holds * (off - old[:, :3] + old[:, 3:]).abs()).mean()
    if made.logits is not None:
        for k, (name, shares) in enumerate(SHARES.items()):
            weights = torch.tensor(shares, device=off.device).rsqrt()
            logits = made.logits[:, 3 * k : 3 * k + 3]
            terms[name] = CLASSES_COUNT * F.cross_entropy(logits, classes[:, k], weights)
    return terms


def displayed(made: Made, target: Float[Tensor, "b 5 H W"]) -> Float[Tensor, "b 6 H W"]:
    """The image beside its truth, as they are compared and looked at."""
    with torch.autocast(target.device.type, enabled=False):
        return to_display(torch.cat((untonemap(made.mixed.image), target[:, :3]), 1))


recipe = Recipe(
    loss=loss, mode="pass", shaded=8, truths=8, labels=True, crop=(64, 64), batch=2, steps=1000, rate=2e-3, warmup=50
)
