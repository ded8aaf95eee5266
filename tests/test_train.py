"""The training loop: it learns, resumes bit for bit, shares work, and says what is wrong."""

import json
import os
import socket
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
import torch.multiprocessing as mp
from conftest import write_disc_clip
from passing import shot, write_shots
from torch import Tensor

from framecast import checkpoint, nets, train
from framecast.clip import ClipError
from framecast.data import Footage, footage
from framecast.fit import method_named
from framecast.frame import Frame
from framecast.methods import extranet
from framecast.methods.extranet import Config, ExtraNet
from framecast.nets import BatchNorm
from framecast.recipe import Recipe
from framecast.train import Settings, command, rate

TINY = Config(widths=(4, 4, 4, 4))
RECIPE = replace(extranet.recipe, crop=(16, 16), batch=4, steps=6, warmup=2)
SETTINGS = Settings(precision="float32", log=1, save=3, pictures=0)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Footage:
    folder = tmp_path_factory.mktemp("train")
    return footage(write_shots(folder / "clip", 8, square=2.0), folder / "cache")


def run(
    source: Footage, folder: Path, recipe: Recipe = RECIPE, settings: Settings = SETTINGS, config: Config = TINY
) -> ExtraNet:
    torch.manual_seed(0)
    method = ExtraNet(config)
    train.train("extranet", method, recipe, [source], folder, settings)
    return method


def lines(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def same(a: ExtraNet, b: ExtraNet) -> bool:
    mine, theirs = a.state_dict(), b.state_dict()
    return all(torch.equal(mine[name], theirs[name]) for name in mine)


class Broken:
    """A loss that goes wrong from its n-th call on."""

    def __init__(self, calls: int, error: type[BaseException] | None = None) -> None:
        self.__qualname__ = "loss"
        self.left, self.error = calls, error

    def __call__(self, method: Any, frames: Sequence[Frame], target: Tensor) -> dict[str, Tensor]:
        self.left -= 1
        terms = extranet.loss(method, frames, target)
        if self.left >= 0:
            return terms
        if self.error is not None:
            raise self.error
        return {name: term * torch.nan for name, term in terms.items()}


def test_the_rate_rises_and_falls() -> None:
    recipe = replace(RECIPE, steps=100, warmup=10, rate=1.0, floor=0.01)
    rates = [rate(recipe, step) for step in range(101)]
    assert rates[0] == pytest.approx(0.1)
    assert rates[10] == pytest.approx(1.0)
    assert rates[55] == pytest.approx(0.505)
    assert rates[100] == pytest.approx(0.01)
    assert rates[10:] == sorted(rates[10:], reverse=True)


def test_the_loss_falls(source: Footage, tmp_path: Path) -> None:
    """Below that of the same network on the same samples, had it learned nothing."""
    for name, highest in (("learned", 5e-3), ("still", 0.0)):
        run(source, tmp_path / name, replace(RECIPE, steps=20, rate=highest, floor=0.0, stops=0.0))
    learned, still = ([line["loss"] for line in lines(tmp_path / name)] for name in ("learned", "still"))
    assert sum(learned[-5:]) < 0.9 * sum(still[-5:])


def test_settled_normalisation_no_longer_follows_batches(source: Footage, tmp_path: Path) -> None:
    """With weights held still, its statistics after six steps are those of the three before it settled."""
    still = replace(RECIPE, rate=0.0, floor=0.0)
    plans = (replace(still, settle=0.5), replace(still, steps=3, settle=1.0), replace(still, settle=1.0))
    settled, three, six = (run(source, tmp_path / str(k), plan).state_dict() for k, plan in enumerate(plans))
    means = [name for name in settled if name.endswith("running_mean")]
    assert means
    for name in means:
        assert torch.equal(settled[name], three[name])
        assert not torch.equal(settled[name], six[name])


def test_a_run_can_begin_with_weights(source: Footage, tmp_path: Path) -> None:
    """The first step is tiny (warm-up), so the weights after it are nearly those it began with."""
    about = {"clips": str(source.clip.path), "steps": 1, "batch": 1, "crop": 16, "cache": tmp_path / "cache"}
    command("extranet", out=tmp_path / "a", settings=SETTINGS, **about)
    begun = replace(SETTINGS, seed=3, initial=tmp_path / "a" / "weights.safetensors")
    command("extranet", out=tmp_path / "b", settings=begun, **about)
    first, second = (checkpoint.load(tmp_path / name / "weights.safetensors")[0] for name in "ab")
    for name in (key for key in first if key.endswith("weight")):
        torch.testing.assert_close(second[name], first[name], atol=1e-4, rtol=0)
    named = method_named(f"extranet={tmp_path / 'a' / 'weights.safetensors'}").state_dict()
    assert all(torch.equal(named[name], value) for name, value in first.items())


def test_weights_on_the_command_line_are_of_a_trainable_method(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no method 'hold'; use one of extranet"):
        method_named(f"hold={tmp_path / 'w.safetensors'}")
    with pytest.raises(ValueError, match="use extranet-published=FILE"):
        method_named("extranet-published")
    with pytest.raises(ValueError, match="extranet= names no file of weights"):
        method_named("extranet=")
    with pytest.raises(FileNotFoundError, match="framecast train wrote"):
        method_named(f"extranet={tmp_path / 'w.safetensors'}")


def test_a_run_folder_is_complete(source: Footage, tmp_path: Path) -> None:
    method = run(source, tmp_path, settings=replace(SETTINGS, pictures=6))
    about = json.loads((tmp_path / "config.json").read_text())
    assert about["method"] == "extranet"
    assert about["config"]["widths"] == [4, 4, 4, 4]
    assert about["recipe"]["batch"] == 4
    assert [line["step"] for line in lines(tmp_path)] == [1, 2, 3, 4, 5, 6]
    assert {"loss", "l1", "hole", "shade", "rate", "samples_per_second", "waiting"} < set(lines(tmp_path)[0])
    assert (tmp_path / "pictures" / "000006.png").is_file()
    again = checkpoint.fill(ExtraNet(TINY), "extranet", tmp_path / "weights.safetensors")
    assert same(method, again)
    tensors, _ = checkpoint.load(tmp_path / "weights.safetensors")
    assert not any(name.startswith("optimiser") for name in tensors)


@pytest.mark.parametrize("calls", [1, 4])
def test_an_interrupted_run_ends_as_if_it_had_not_been(source: Footage, tmp_path: Path, calls: int) -> None:
    """Stopped before the first checkpoint, and between two."""
    straight = run(source, tmp_path / "a")
    with pytest.raises(KeyboardInterrupt):
        run(source, tmp_path / "b", replace(RECIPE, loss=Broken(calls, KeyboardInterrupt)))
    resumed = run(source, tmp_path / "b")
    assert same(straight, resumed)
    assert [x["loss"] for x in lines(tmp_path / "a")] == [x["loss"] for x in lines(tmp_path / "b")]


def test_time_ends_a_call_and_the_next_goes_on(source: Footage, tmp_path: Path) -> None:
    brief = replace(SETTINGS, minutes=1e-9)
    run(source, tmp_path, settings=brief)
    assert lines(tmp_path) == []
    assert same(run(source, tmp_path), run(source, tmp_path / "other"))


def _process(rank: int, port: int, source: Footage, folder: Path) -> None:
    torch.set_num_threads(1)
    where = {"RANK": rank, "WORLD_SIZE": 2, "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    os.environ.update({name: str(value) for name, value in where.items()})
    run(source, folder, replace(RECIPE, steps=4))
    torch.distributed.destroy_process_group()


def test_two_processes_are_one_with_twice_the_batch(source: Footage, tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    plain = replace(source, clip=replace(source.clip, load=dict))  # closures do not travel; samples read the arrays
    arrays = {name: array[:] for name, array in source.arrays.items()}
    mp.spawn(_process, (port, replace(plain, arrays=arrays), tmp_path / "two"), nprocs=2)
    run(source, tmp_path / "one", replace(RECIPE, steps=4))
    one, two = ([line["loss"] for line in lines(tmp_path / name)] for name in ("one", "two"))
    assert len(set(one)) == 4
    assert two == pytest.approx(one, rel=1e-4)


# What can go wrong.


def test_a_loss_that_is_no_number_stops_and_keeps_the_last_good_state(source: Footage, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"step 4, on clip, frame \d+, row \d+, column \d+") as caught:
        run(source, tmp_path, replace(RECIPE, loss=Broken(4)))
    assert str(tmp_path / "checkpoint.safetensors") in str(caught.value)
    tensors, about = checkpoint.load(tmp_path / "checkpoint.safetensors")
    assert about["step"] == 4
    assert all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values() if tensor.is_floating_point())


def test_statistics_that_are_no_numbers_are_not_kept(source: Footage, tmp_path: Path) -> None:
    """They follow every batch, also the one that ends a run."""

    class Spoiling(Broken):
        def __call__(self, method: Any, frames: Sequence[Frame], target: Tensor) -> dict[str, Tensor]:
            terms = super().__call__(method, frames, target)
            if self.left < 0:
                next(b for name, b in method.named_buffers() if name.endswith("running_mean")).data.fill_(torch.nan)
            return terms

    with pytest.raises(ValueError, match=r"step 1, .*no state was saved before it"):
        run(source, tmp_path / "early", replace(RECIPE, loss=Spoiling(1)))
    with pytest.raises(ValueError, match=r"step 4, .*last good state is kept"):
        run(source, tmp_path / "late", replace(RECIPE, loss=Spoiling(4)))
    assert checkpoint.load(tmp_path / "late" / "checkpoint.safetensors")[1]["step"] == 3


def test_a_run_goes_on_with_weights_that_its_loss_does_not_reach(source: Footage, tmp_path: Path) -> None:
    def go(loss: Any) -> None:
        method = ExtraNet(TINY)
        method.idle = torch.nn.Linear(2, 2)
        train.train("extranet", method, replace(RECIPE, loss=loss), [source], tmp_path, SETTINGS)

    with pytest.raises(KeyboardInterrupt):
        go(Broken(4, KeyboardInterrupt))
    go(extranet.loss)
    assert lines(tmp_path)[-1]["step"] == RECIPE.steps


def test_a_line_of_the_log_that_was_cut_off_is_dropped(source: Footage, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(source, tmp_path, replace(RECIPE, loss=Broken(4, KeyboardInterrupt)))
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"step": 5, "lo')
    run(source, tmp_path)
    assert [line["step"] for line in lines(tmp_path)] == [1, 2, 3, 4, 5, 6]


def test_the_guilty_sample_is_named_alone(source: Footage) -> None:
    samples = train.Samples([source], RECIPE, fields=(*ExtraNet.needs, *ExtraNet.needs_generated), seed=0)
    batch = next(train.batches(samples, 0))
    bad = float(batch.targets[2].mean())

    def loss(method: Any, frames: Sequence[Frame], target: Tensor) -> dict[str, Tensor]:
        return {"l": target.mean() * (torch.nan if abs(float(target[0].mean()) - bad) < 1e-6 else 1.0)}

    assert train.guilty(ExtraNet(TINY), replace(RECIPE, loss=loss), batch) == batch.names[2]


def test_another_run_in_the_folder_is_refused(source: Footage, tmp_path: Path) -> None:
    run(source, tmp_path, replace(RECIPE, steps=1))
    with pytest.raises(ValueError, match="holds another run: seed 0 instead of 1"):
        run(source, tmp_path, replace(RECIPE, steps=1), replace(SETTINGS, seed=1))
    with pytest.raises(ValueError, match="another run: recipe steps 1 instead of 2; choose"):
        run(source, tmp_path, replace(RECIPE, steps=2))
    (tmp_path / "config.json").write_text('{"method": ')
    with pytest.raises(ValueError, match=r"config.json is damaged \(.*\); choose another folder"):
        run(source, tmp_path, replace(RECIPE, steps=1))


def test_weights_of_something_else_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    method = ExtraNet(TINY)
    checkpoint.save(path, method.state_dict(), checkpoint.describe("extranet", method))
    with pytest.raises(ValueError, match="holds extranet, not fasset"):
        checkpoint.fill(ExtraNet(TINY), "fasset", path)
    with pytest.raises(ValueError, match="history True instead of False"):
        checkpoint.fill(ExtraNet(replace(TINY, history=False)), "extranet", path)
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ValueError, match="truncated or damaged"):
        checkpoint.fill(method, "extranet", path)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        checkpoint.fill(method, "extranet", tmp_path / "none.safetensors")
    checkpoint.save(path, {}, checkpoint.describe("extranet", method))
    with pytest.raises(ValueError, match="does not fit this version"):
        checkpoint.fill(method, "extranet", path)
    checkpoint.save(path, {"a": torch.ones(1)}, {})
    with pytest.raises(ValueError, match="which method"):
        checkpoint.load(path)


def test_a_full_disk_keeps_the_file_that_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "weights.safetensors"
    checkpoint.save(path, {"a": torch.ones(2)}, {"method": "x"})

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(ClipError, match="No space left"):
        checkpoint.save(path, {"a": torch.zeros(2)}, {"method": "x"})
    assert torch.equal(checkpoint.load(path)[0]["a"], torch.ones(2))


# The command.


def test_the_command_trains_and_says_what_it_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_shots(tmp_path / "clips" / "a", 6)
    settings = replace(SETTINGS, save=1)
    command("extranet", str(tmp_path / "clips/*"), tmp_path / "run", 1, 2, 16, tmp_path / "cache", settings)
    assert "extranet on 1 clips" in capsys.readouterr().out
    assert checkpoint.fill(ExtraNet(extranet.BETTER), "extranet", tmp_path / "run" / "weights.safetensors")


def test_the_command_refuses_what_it_cannot_do(tmp_path: Path) -> None:
    write_disc_clip(tmp_path / "disc", 6)
    with pytest.raises(ClipError, match="has no albedo"):
        command("extranet", str(tmp_path / "disc"), tmp_path / "run")
    with pytest.raises(ValueError, match="nothing that is trained"):
        command("hold", str(tmp_path / "disc"), tmp_path / "run")
    with pytest.raises(FileNotFoundError, match="no clip matches"):
        command("extranet", str(tmp_path / "none*"), tmp_path / "run")
    for wrong in ({"steps": 0}, {"batch": -1}, {"crop": 0}, {"settings": replace(SETTINGS, save=0)}):
        with pytest.raises(ValueError, match=r"it has to be a whole number, at least 1"):
            command("extranet", str(tmp_path / "disc"), tmp_path / "run", **wrong)
    assert not (tmp_path / "run").exists()


def test_shots_are_consistent() -> None:
    """The analytic clip behind these tests: what moves is where its vectors say."""
    now, before = shot(5.0, square=2.0, span=1.0), shot(4.0, square=2.0)
    assert now.object is not None
    assert before.object is not None
    assert torch.equal(torch.roll(before.object, 2, 3), now.object)


def test_shared_normalisation_of_a_constant_is_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whose variance, the difference of two large sums, rounding would make negative."""
    monkeypatch.setattr(nets.dist, "is_initialized", lambda: True)
    monkeypatch.setattr(nets.dist, "get_world_size", lambda: 2)
    monkeypatch.setattr(nets, "_summed", lambda values: values)
    for constant in (37.3, 123.4, 777.7):
        image = BatchNorm(2).train()(torch.full((4, 2, 31, 33), constant))
        torch.testing.assert_close(image, torch.zeros_like(image), atol=0.5, rtol=0)
