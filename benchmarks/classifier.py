"""What the classifier of `classifier` finds, and what knowing it is worth; as parts of docs/results/classifier.md.

    python benchmarks/classifier.py classes CLIP...
    python benchmarks/classifier.py initial RUN/weights.safetensors VARIANT -o FILE
    python benchmarks/classifier.py variants CLIP... [--runs FOLDER]

Clips are rendered with --ranges. `initial` makes the first weights of a variant: those of the whole method without what
the variant does not see, so that a few steps of training tell what that was worth.
"""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import torch
import tyro
from quality import TITLES
from super_resolution import write
from torch import Tensor
from tyro.conf import Positional, arg

from framecast import checkpoint
from framecast.clip import Clip, open_clip
from framecast.color import untonemap
from framecast.evaluate import Footage, Settings, index_at, judged, run
from framecast.fit import method_named
from framecast.frame import Frame
from framecast.labels import ALIASING, GHOSTING, NONE, likeliest
from framecast.labels import labels as true_labels
from framecast.methods.classifier import Classifier, kept
from framecast.methods.classifier_buffers import State
from framecast.train import trainable

PAGE = Path("docs/results/classifier.md")
REGIONS = ("all", "disoccluded", "shading", "thin", "static")
VARIANTS = {
    "classifier": "whole",
    "classifier-true-labels": "true classes in place of the network's (ceiling)",
    "classifier-none": "without a classifier (floor)",
    "classifier-without-counter": "without the counter",
    "classifier-without-carried": "without the last classes",
    "classifier-without-range": "without the last range of colours",
}


def truth(clip: Clip, index: int) -> Tensor:
    """The true classes of a frame: 1 2 H W."""
    found = true_labels(clip, index)
    return torch.cat((found.ghosting, found.aliasing), 1)


# What is found.


@torch.no_grad()
def confusion(method: Any, clip: Clip) -> Tensor:
    """Pixels by (ghosting or aliasing, true class, found class), over all frames but the first."""
    counts, state = torch.zeros(2, 3, 3), method.start(clip[0])
    for index in range(len(clip)):
        _, state = method(clip[index], state)
        if index == 0:
            continue
        found = likeliest(state.classes)
        for k, (true, ours) in enumerate(zip(truth(clip, index)[0], (found.ghosting, found.aliasing), strict=True)):
            counts[k] += torch.bincount(true.flatten() * 3 + ours.flatten(), minlength=9).view(3, 3)
    return counts


def classes(clips: Positional[tuple[Path, ...]], method: str = "classifier", page: Path = PAGE) -> None:
    """Precision and recall of every class.

    Args:
        clips: clips that nothing was trained on.
        method: the method, or classifier=FILE.
        page: the markdown page.
    """
    each = {path.name: confusion(method_named(method), open_clip(path)) for path in clips}
    lines = ["Precision / recall of the likeliest class, and the share of pixels that truly are of it, all frames but"]
    lines += [
        "the first of each clip.",
        "",
        f"| class | {' | '.join(each)} | all pixels |",
        "|---" * (len(each) + 2) + "|",
    ]
    for k, names in enumerate((GHOSTING, ALIASING)):
        for one, name in enumerate(names):
            cells = [cell(counts[k], one) for counts in (*each.values(), sum(each.values()))]  # type: ignore[index]
            lines.append(f"| {name} | {' | '.join(cells)} |")
    write(page, "What is found", lines)


def cell(counts: Tensor, one: int) -> str:
    """Precision / recall (share) of a class from pixels by true and found class."""
    right, found, true = float(counts[one, one]), float(counts[:, one].sum()), float(counts[one].sum())
    precision, recall = (f"{right / n:.2f}" if n else "-" for n in (found, true))
    return f"{precision} / {recall} ({100 * true / float(counts.sum()):.1f} %)"


# What it is worth.

LAYERS: dict[str, tuple[int, dict[str, int]]] = {
    "classify.blocks.0.0.weight": (4, {"": 10, "counter": 1, "range": 6, "carried": 6}),
    "mix.0.weight": (1, {"": 19, "counter": 2, "classifier": 14}),
}
"""Of each network the pixels that one of its own stands for, and the planes that its first layer sees, by the switch of
`Config` that takes them away."""


def initial(weights: Positional[Path], variant: Positional[str], out: Annotated[Path, arg(aliases=["-o"])]) -> None:
    """First weights of a variant: those of the whole method, less the columns of what the variant does not see.

    Args:
        weights: what a run of `classifier` wrote.
        variant: its name in `framecast train`.
        out: the file.
    """
    made: Any = trainable(variant)[0]()
    tensors = checkpoint.fill(Classifier(), "classifier", weights).state_dict()
    tensors = {name: value for name, value in tensors.items() if name in made.state_dict()}
    for name in tensors.keys() & LAYERS.keys():
        pixels, planes = LAYERS[name]
        seen = [not switch or getattr(made.config, switch) for switch, count in planes.items() for _ in range(count)]
        tensors[name] = tensors[name][:, torch.tensor(seen).repeat_interleave(pixels)]
    checkpoint.save(out, tensors, checkpoint.describe(variant, made))


class Told(torch.nn.Module):
    """`classifier` that is told the classes of a clip."""

    def __init__(self, method: Classifier, clip: Clip, what: str) -> None:
        """`what`: the truth, or that all is none."""
        super().__init__()
        self.method, self.clip, self.what = method, clip, what
        self.config, self.needs_generated, self.step_motion = method.config, (), False
        self.start = method.start

    def forward(self, frame: Frame, state: State) -> tuple[Tensor, State]:
        found = truth(self.clip, index_at(self.clip, float(frame.time)))
        made = self.method.make(frame, state, found if self.what == "truth" else torch.full_like(found, NONE))
        return untonemap(made.mixed.image), kept(made, frame)


def scores(method: Any, clip: Clip) -> dict[str, float]:
    """PSNR by region, the mean of the frames."""
    settings, footage = Settings(("psnr",)), Footage(clip)
    found: dict[str, list[float]] = defaultdict(list)
    for one in run(footage, method, "pass", settings):
        for (_, region, _), value in judged(footage, [one], "pass", settings).items():
            found[region].append(value)
    return {region: fmean(values) for region, values in found.items()}


def variants(
    clips: Positional[tuple[Path, ...]],
    method: str = "classifier",
    runs: Path | None = None,
    steps: int = 0,
    page: Path = PAGE,
) -> None:
    """PSNR of the method told other classes than its own, and of what was trained without parts of it.

    Args:
        clips: clips that nothing was trained on.
        method: the method, or classifier=FILE.
        runs: folder of runs that are named as their variants; those that it holds are measured.
        steps: how many more steps each was trained.
        page: the markdown page.
    """
    opened = [open_clip(path) for path in clips]
    made: Any = method_named(method)
    rows: dict[str, Callable[[Clip], Any]] = {
        "classifier": lambda clip: made,
        "told the true classes": lambda clip: Told(made, clip, "truth"),
        'told "none" everywhere': lambda clip: Told(made, clip, "none"),
    }
    for name, called in VARIANTS.items():
        path = Path("none") if runs is None else runs / name / "weights.safetensors"
        if path.is_file():
            other: Any = method_named(f"{name}={path}")
            told = name == "classifier-true-labels"
            rows[f"{called}, {steps} more steps"] = (
                lambda clip, other=other, told=told: Told(other, clip, "truth") if told else other  # type: ignore[misc]
            )
    lines = [f"PSNR in dB, mean of {', '.join(clip.path.name for clip in opened)}.", ""]
    lines += [f"| variant | {' | '.join(TITLES[region] for region in REGIONS)} |", "|---" * (len(REGIONS) + 1) + "|"]
    for called, make in rows.items():
        found = [scores(make(clip), clip) for clip in opened]
        cells = [f"{fmean(each[region] for each in found if region in each):.2f}" for region in REGIONS]
        lines.append(f"| {called} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    write(page, "What it is worth", lines)


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"classes": classes, "initial": initial, "variants": variants})
