"""One training loop for every method.

    run/config.json              method, configuration, recipe, seed, clips
    run/weights.safetensors      the weights alone, for use
    run/checkpoint.safetensors   weights and optimiser state of one step, in one file so that they cannot disagree
    run/log.jsonl                one line every few steps: loss and its terms, rate, samples per second, waiting
    run/pictures/000500.png      last shaded frame, generated image, truth, difference
    run/tensorboard/             the same scalars, where tensorboard is installed

Started again on the same folder, a run goes on from its last checkpoint, bit for bit as if it had not been stopped.
Under `torchrun` (or `accelerate launch`) the processes share the samples of every step.
"""

import glob
import importlib.util
import json
import math
import os
import time as clock
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
import torch.distributed as dist
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor, nn
from torch.utils._pytree import tree_map_only
from tyro.conf import Positional, arg

from framecast import checkpoint
from framecast.color import to_display
from framecast.data import Batch, Footage, Samples, batches, footage
from framecast.exr import whole
from framecast.fit import require
from framecast.frame import Frame
from framecast.importers import open_any
from framecast.methods import TRAINABLE
from framecast.nets import has_fast_bfloat16
from framecast.recipe import Recipe
from framecast.runtime import require_device

Method = Any


@dataclass(frozen=True)
class Settings:
    """How a run goes, apart from what decides its result."""

    seed: int = 0
    device: str = "cpu"
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """auto: bfloat16 where the device is faster with it."""
    workers: int = 0
    """Processes that read samples; 0: the training process itself."""
    log: int = 20
    """Steps between lines of the log."""
    save: int = 500
    """Steps between checkpoints."""
    pictures: int = 2000
    """Steps between strips of pictures; 0: none."""
    minutes: float = math.inf
    """Stop, with a checkpoint, after so long; the same command goes on."""
    initial: Path | None = None
    """Weights to begin with, of the same method; by default random ones."""


def train(
    name: str, method: Method, recipe: Recipe, sources: Sequence[Footage], folder: Path, settings: Settings = Settings()
) -> bool:
    """Trains, or goes on training, a method in a run folder; True when the last step is done.

    Raises:
        ValueError: no such device, the folder holds another run, a checkpoint is damaged, or the loss is no longer a
            number.
        ClipError: samples cannot be made, or files not written.
    """
    rank, world = processes(settings.device)
    device = f"cuda:{os.environ.get('LOCAL_RANK', 0)}" if settings.device == "cuda" else settings.device
    require_device(device)
    fast = settings.precision == "bfloat16" or (settings.precision == "auto" and has_fast_bfloat16(device))
    method = method.to(device, memory_format=torch.channels_last) if fast else method.to(device)
    optimiser = torch.optim.Adam(method.parameters(), lr=0.0, betas=recipe.betas)
    fields = dict.fromkeys((*method.needs, *method.needs_generated))
    samples = Samples(
        sources,
        recipe,
        fields=tuple(fields),
        seed=settings.seed,
        scale=method.config.scale,
        motion="step" if method.step_motion else "gap",
    )
    about = {**checkpoint.describe(name, method), **described(recipe, sources, settings)}
    start = resume(folder, name, method, optimiser, about) if (folder / "config.json").is_file() else 0
    if start == 0 and rank == 0:
        write_json(folder / "config.json", about)
    feed = batches(samples, start, rank=rank, world=world, workers=settings.workers, pin=device.startswith("cuda"))
    recorder = Recorder(folder, start, recipe, settings, quiet=rank > 0)
    began = clock.perf_counter()
    step = start
    with recorder:
        while step < recipe.steps and not is_over(began, settings.minutes, device):
            waited = clock.perf_counter()
            batch = to(next(feed), device)
            recorder.waited(clock.perf_counter() - waited)
            learning(method, settled=step >= recipe.settle * recipe.steps)
            for group in optimiser.param_groups:
                group["lr"] = rate(recipe, step)
            terms = improve(method, recipe, optimiser, batch, fast)
            if terms is None:
                if rank == 0 and is_sound(method):
                    save(folder, name, method, optimiser, step)
                raise ValueError(lost(folder, step, guilty(method, recipe, batch)))
            step += 1
            recorder.step(step, terms, rate(recipe, step - 1))
            if rank == 0 and settings.pictures and step % settings.pictures == 0:
                picture(method, batch, folder / "pictures" / f"{step:06d}.png")
            if rank == 0 and step % settings.save == 0:
                save(folder, name, method, optimiser, step)
        if rank == 0 and step > start:
            save(folder, name, method, optimiser, step)
    return step >= recipe.steps


def learning(method: Method, *, settled: bool) -> None:
    """Puts the method into training; its batch normalisation, where settled, into use."""
    method.train()
    for layer in method.modules():
        if settled and isinstance(layer, nn.BatchNorm2d):
            layer.eval()


def improve(
    method: Method, recipe: Recipe, optimiser: torch.optim.Optimizer, batch: Batch, fast: bool
) -> dict[str, Tensor] | None:
    """One step of the optimiser; the terms of the loss before it, averaged over the processes.

    None where the gradient is no number: no weight has changed then.
    """
    optimiser.zero_grad(set_to_none=True)
    with torch.autocast(batch.targets.device.type, torch.bfloat16, enabled=fast):
        terms = recipe.loss(method, batch.frames, batch.targets)
    torch.stack(list(terms.values())).sum().backward()
    share([p.grad for p in method.parameters() if p.grad is not None])
    norm = nn.utils.clip_grad_norm_(method.parameters(), recipe.clip_norm)
    if not bool(torch.isfinite(norm)):
        return None
    optimiser.step()
    values = torch.stack(list(terms.values())).detach()
    share([values])
    return dict(zip(terms, values, strict=True))


def is_sound(method: Method) -> bool:
    """Whether everything that the method has learnt is a number, statistics of normalisation included."""
    return all(bool(torch.isfinite(value).all()) for value in method.state_dict().values())


def lost(folder: Path, step: int, names: str) -> str:
    """Says where the loss was no number, and how to go on."""
    path = folder / "checkpoint.safetensors"
    good = (
        f"the last good state is kept in {path}: begin another run with it (--initial, another "
        f"--seed), or leave that clip out"
        if path.is_file()
        else "no state was saved before it: leave that clip out, or take another --seed"
    )
    return f"the loss is no longer a number at step {step}, on {names}; {good}"


def guilty(method: Method, recipe: Recipe, batch: Batch) -> str:
    """Names of the samples of a batch whose loss is not a number on their own; of all where none is."""
    method.eval()
    found = []
    for k, name in enumerate(batch.names):
        frames, targets = one(batch, k)
        with torch.no_grad():
            terms = recipe.loss(method, frames, targets)
        if not all(bool(torch.isfinite(term)) for term in terms.values()):
            found.append(name)
    return "; ".join(found or batch.names)


def one(batch: Batch, index: int) -> tuple[tuple[Frame, ...], Tensor]:
    """One sample of a batch: its frames and their truth."""
    alone: tuple[tuple[Frame, ...], Tensor] = tree_map_only(
        Tensor, lambda t: t[index : index + 1], (batch.frames, batch.targets)
    )
    return alone


def rate(recipe: Recipe, step: int) -> float:
    """Learning rate of a step: a straight rise, then half a cosine down to the floor."""
    if step < recipe.warmup:
        return recipe.rate * (step + 1) / recipe.warmup
    part = (step - recipe.warmup) / max(1, recipe.steps - recipe.warmup)
    return recipe.floor + (recipe.rate - recipe.floor) * (1 + math.cos(math.pi * min(1.0, part))) / 2


# Several processes.


def processes(device: str) -> tuple[int, int]:
    """Rank of this process and how many there are, from the variables that launchers set; joins them."""
    world = int(os.environ.get("WORLD_SIZE", 1))
    if world > 1 and not dist.is_initialized():
        dist.init_process_group("nccl" if device.startswith("cuda") else "gloo")
    return (dist.get_rank(), world) if world > 1 else (0, 1)


def is_over(began: float, minutes: float, device: str) -> bool:
    """Whether so many minutes have gone by, on average over the processes, so that all of them stop at once."""
    if math.isinf(minutes):
        return False
    spent = torch.tensor([clock.perf_counter() - began], device=device)
    share([spent])
    return float(spent) >= minutes * 60


def share(tensors: Sequence[Tensor]) -> None:
    """Replaces tensors by their means over all processes, in one message."""
    if not dist.is_initialized() or dist.get_world_size() == 1:
        return
    flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
    dist.all_reduce(flat)
    flat /= dist.get_world_size()
    for tensor, mean in zip(tensors, flat.split([t.numel() for t in tensors]), strict=True):
        tensor.copy_(mean.view(tensor.shape))


def to(batch: Batch, device: str) -> Batch:
    """The batch on a device."""
    frames = tuple(frame.to(device) for frame in batch.frames)
    return Batch(frames, batch.targets.to(device, non_blocking=True), batch.names)


# The run folder.


def described(recipe: Recipe, sources: Sequence[Footage], settings: Settings) -> dict[str, Any]:
    """What decides the result of a run besides the method."""
    # Runs that began before there were labels go on.
    values = {key: value for key, value in asdict(recipe).items() if key != "loss" and (key != "labels" or value)}
    terms = getattr(recipe.loss, "__qualname__", str(recipe.loss))
    clips = sorted(source.clip.path.name for source in sources)
    plain: dict[str, Any] = json.loads(json.dumps({"recipe": {"loss": terms, **values}, "clips": clips}))
    return {**plain, "seed": settings.seed, "initial": settings.initial and str(settings.initial)}


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Writes a file whole."""
    with whole(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1))


def save(folder: Path, name: str, method: Method, optimiser: torch.optim.Optimizer, step: int) -> None:
    """Writes the checkpoint of a step, and the weights alone."""
    weights = method.state_dict()
    moments = {
        f"optimiser.{key}.{parameter}": value
        for parameter, tensor in method.named_parameters()
        for key, value in optimiser.state.get(tensor, {}).items()
    }
    about = checkpoint.describe(name, method)
    checkpoint.save(folder / "checkpoint.safetensors", {**weights, **moments}, {**about, "step": step})
    checkpoint.save(folder / "weights.safetensors", weights, {**about, "step": step})


def single(about: Mapping[str, Any], keys: Iterable[str]) -> dict[str, Any]:
    """What is said of a run under these keys, each value by itself; those of its recipe become "recipe steps" etc."""
    plain: dict[str, Any] = {}
    for key in keys:
        value = about.get(key)
        plain |= {f"{key} {k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
    return plain


def resume(folder: Path, name: str, method: Method, optimiser: torch.optim.Optimizer, about: Mapping[str, Any]) -> int:
    """Puts the last checkpoint of a run back; the number of steps done.

    Raises:
        ValueError: the folder holds a run with other settings, or a damaged checkpoint.
    """
    try:
        found = json.loads((folder / "config.json").read_text())
    except ValueError as error:
        raise ValueError(f"{folder / 'config.json'} is damaged ({error}); choose another folder") from error
    held, wanted = single(found if isinstance(found, dict) else {}, about), single(about, about)
    differ = [key for key in dict.fromkeys((*wanted, *held)) if held.get(key) != wanted.get(key)]
    if differ:
        each = ", ".join(f"{key} {held.get(key)} instead of {wanted.get(key)}" for key in differ)
        raise ValueError(f"{folder} holds another run: {each}; choose another folder, or use the settings of that run")
    path = folder / "checkpoint.safetensors"
    if not path.is_file():
        return 0
    tensors, said = checkpoint.load(path)
    checkpoint.require(path, said, name, method)
    checkpoint.put(method, {k: v for k, v in tensors.items() if not k.startswith("optimiser.")}, path)
    for parameter, tensor in method.named_parameters():
        names = {key: f"optimiser.{key}.{parameter}" for key in ("step", "exp_avg", "exp_avg_sq")}
        state = {key: tensors[name] for key, name in names.items() if name in tensors}
        if state:  # a weight that the loss has not reached yet has none
            optimiser.state[tensor] = {
                key: value if key == "step" else torch.empty_like(tensor).copy_(value) for key, value in state.items()
            }
    return int(said["step"])


class Recorder:
    """What is shown and written of a run while it goes."""

    def __init__(self, folder: Path, start: int, recipe: Recipe, settings: Settings, *, quiet: bool) -> None:
        self.path, self.batch, self.every, self.quiet = folder / "log.jsonl", recipe.batch, settings.log, quiet
        self.sums: dict[str, Tensor] = {}
        self.count, self.waiting, self.since = 0, 0.0, clock.perf_counter()
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
        shown = TextColumn("loss {task.fields[loss]:.4f}  {task.fields[speed]:.1f} frames/s")
        self.progress = Progress(*columns, shown, TimeRemainingColumn(), disable=quiet, transient=True)
        self.task = self.progress.add_task("train", total=recipe.steps, completed=start, loss=math.nan, speed=0.0)
        self.board: Any = None
        if not quiet:
            self._keep_until(start)
            if importlib.util.find_spec("tensorboard") is not None:
                from torch.utils.tensorboard import SummaryWriter

                self.board = SummaryWriter(folder / "tensorboard", purge_step=start)

    def _keep_until(self, start: int) -> None:
        """Drops lines of steps that are done again, and one that was cut off when the run was."""
        lines = self.path.read_text().splitlines(keepends=True) if self.path.is_file() else []
        kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= start]
        with whole(self.path) as temporary:
            temporary.write_text("".join(kept))

    def __enter__(self) -> "Recorder":
        self.progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.progress.stop()
        if self.board is not None:
            self.board.close()

    def waited(self, seconds: float) -> None:
        """Adds time that training spent waiting for samples."""
        self.waiting += seconds

    def step(self, step: int, terms: Mapping[str, Tensor], rate: float) -> None:
        """Adds the terms of a step; writes a line every so often."""
        for key, value in terms.items():
            self.sums[key] = self.sums[key] + value if key in self.sums else value
        self.count += 1
        if step % self.every == 0 and not self.quiet:
            self.write(step, rate)

    def write(self, step: int, rate: float) -> None:
        """One line of the log: means since the last one."""
        means = {key: float(value) / self.count for key, value in self.sums.items()}
        spent = clock.perf_counter() - self.since
        speed, waiting = self.count * self.batch / spent, self.waiting / spent
        line = {"step": step, "loss": sum(means.values()), **means, "rate": rate}
        line |= {"samples_per_second": round(speed, 3), "waiting": round(waiting, 4)}
        with self.path.open("a") as file:
            file.write(json.dumps(line) + "\n")
        for key, value in line.items():
            if self.board is not None and key != "step":
                self.board.add_scalar(key, value, step)
        self.progress.update(self.task, completed=step, loss=line["loss"], speed=speed)
        self.sums, self.count, self.waiting, self.since = {}, 0, 0.0, clock.perf_counter()


def picture(method: Method, batch: Batch, path: Path) -> None:
    """The first sample of a batch as a strip: last shaded frame, generated image, truth, four times the difference."""
    from PIL import Image

    frames, targets = one(batch, 0)
    method.eval()
    with torch.no_grad():
        state = method.start(frames[0])
        for frame in frames:
            image, state = method(frame, state)
    color = frames[-2].color
    assert color is not None
    last = nn.functional.interpolate(color, image.shape[-2:])
    shown, truth = to_display(image), to_display(targets[:, -1, :3])
    strip = torch.cat((to_display(last), shown, truth, ((shown - truth).abs() * 4).clamp(max=1)), 3)
    with whole(path) as temporary:
        pixels = (strip[0].permute(1, 2, 0) * 255).round().byte().cpu().numpy()
        Image.fromarray(pixels).save(temporary, format="PNG")


# The command.


def command(
    method: Positional[str],
    clips: str,
    out: Annotated[Path, arg(aliases=["-o"])],
    steps: int | None = None,
    batch: int | None = None,
    crop: int | None = None,
    cache: Path | None = None,
    settings: Settings = Settings(),
) -> None:
    """Train a method on clips at full rate; the same command again goes on where it was.

    Args:
        method: what to train, such as extranet, nsrr, or one of their variants; any other name lists them all.
        clips: clips, as a pattern in quotes, such as 'clips/train/*'.
        out: folder of the run.
        steps: how many steps, instead of the recipe's.
        batch: samples of a step, over all processes, instead of the recipe's.
        crop: height and width of a sample, instead of the recipe's.
        cache: folder for the training cache, instead of the user's cache folder.
    """
    make, recipe = trainable(method)
    counts = {"steps": steps, "batch": batch, "crop": crop, "log": settings.log, "save": settings.save}
    for name, count in counts.items():
        if count is not None and count < 1:
            raise ValueError(f"--{name} is {count}; it has to be a whole number, at least 1")
    square = recipe.crop if crop is None else (crop, crop)
    recipe = replace(recipe, steps=steps or recipe.steps, batch=batch or recipe.batch, crop=square)
    paths = sorted(Path(path) for path in glob.glob(clips))
    if not paths:
        raise FileNotFoundError(f"no clip matches {clips!r}; give a pattern in quotes, such as 'clips/train/*'")
    torch.manual_seed(settings.seed)
    made = make()
    if settings.initial is not None:
        checkpoint.fill(made, method, settings.initial)
    sources = []
    for path in paths:
        clip = open_any(path)
        require(clip, method, made, others=False)
        sources.append(footage(clip, cache, labels=recipe.labels))
    done = train(method, made, recipe, sources, out, settings)
    if dist.is_initialized():
        dist.destroy_process_group()
    state = "done" if done else "stopped in time; run the same command to go on"
    Console().print(f"{method} on {len(sources)} clips -> {out} ({state})", highlight=False, soft_wrap=True)


def trainable(name: str) -> tuple[Callable[[], Method], Recipe]:
    """What makes a method, and its recipe, or one sentence that lists what there is."""
    if name not in TRAINABLE:
        raise ValueError(f"{name!r} is nothing that is trained; use one of {', '.join(TRAINABLE)}")
    return TRAINABLE[name]
