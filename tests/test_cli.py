"""The command line loads what a command needs, and says what there is."""

import subprocess
import sys

import pytest

from framecast.cli import COMMANDS, functions, main


def test_the_doctor_is_loaded_without_methods_and_compilers() -> None:
    code = (
        "import sys; from framecast.cli import functions; print(*functions(['doctor', 'x'])); "
        "print(*{'framecast.methods', 'framecast.train', 'torch._dynamo'} & {*sys.modules})"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told == "doctor\n\n"


def test_every_command_is_a_function_and_is_named_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert functions(["no-such-command"]).keys() == COMMANDS.keys()
    with pytest.raises(SystemExit) as stopped:
        main(["--help"])
    assert stopped.value.code == 0
    told = capsys.readouterr().out
    assert [name for name in COMMANDS if name not in told] == []


def test_it_runs_as_a_module_and_ends_quietly_where_nobody_reads_on() -> None:
    """`python -m framecast ... | head`."""
    with subprocess.Popen(
        [sys.executable, "-m", "framecast", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 141
