"""A file is written whole or not at all, where its links lead, and never over what is read."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from physics import InputError
from physics.machinery.whole_file import check_writable, whole_file

ROOT = Path(__file__).parent.parent


def write(path, text):
    with whole_file(path) as part:
        part.write_text(text)


def test_all_or_nothing(tmp_path):
    file = tmp_path / "a.json"
    file.write_text("old")
    with pytest.raises(KeyboardInterrupt), whole_file(file) as part:
        part.write_text("half")
        raise KeyboardInterrupt
    assert file.read_text() == "old"
    write(file, "new")
    assert file.read_text() == "new"
    assert list(tmp_path.iterdir()) == [file]


def test_a_name_may_be_as_long_as_the_disk_takes(tmp_path):
    file = tmp_path / ("n" * 250 + ".json")
    write(file, "new")
    assert list(tmp_path.iterdir()) == [file]


def test_a_link_stays_one_and_its_target_is_written(tmp_path):
    (tmp_path / "deep").mkdir()
    target, link, longer = tmp_path / "deep" / "data", tmp_path / "a.json", tmp_path / "b.json"
    link.symlink_to("deep/data")
    longer.symlink_to("a.json")
    for path in (link, longer):  # first to where nothing is yet
        write(path, path.name)
        assert link.is_symlink() and longer.is_symlink()
        assert target.read_text() == path.name
    assert list(target.parent.iterdir()) == [target]


def refuse(path, *inputs):
    with pytest.raises(InputError) as error:
        check_writable(path, *inputs)
    return str(error.value)


def test_what_is_no_regular_file_is_refused_and_stays(tmp_path):
    pipe, link, circle = (tmp_path / name for name in ("pipe", "link.json", "circle"))
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    circle.symlink_to(circle)
    for path in (pipe, link, circle):
        assert "no regular file" in refuse(path)
        with pytest.raises(InputError):
            write(path, "x")
    assert pipe.is_fifo() and link.is_symlink() and circle.is_symlink()
    link.unlink()
    link.symlink_to(tmp_path / "gone" / "file")
    assert "there is no folder" in refuse(link)


def test_what_is_read_is_not_written_over(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    read, other, link = (tmp_path / name for name in ("read", "other", "link"))
    read.write_text("precious")
    other.write_text("old")
    link.symlink_to(read)
    for out, of in ((read, read), (link, read), (read, link), ("read", read), (read, "./read")):
        assert "reads it" in refuse(out, None, other, of)
    check_writable(other, None, read, link, tmp_path / "gone")
    check_writable(tmp_path / "new", read, tmp_path / "new")


def test_a_name_that_says_something_else_is_refused(tmp_path):
    check_writable(tmp_path / "a.ONNX", suffix=".onnx")
    with pytest.raises(InputError, match="must end in .onnx"):
        check_writable(tmp_path / "a.txt", suffix=".onnx")


@pytest.mark.skipif(os.name != "posix", reason="tells by signals")
def test_a_process_that_is_told_to_end_ends_though_a_thread_waits_for_ever():
    code = (
        "import os, signal, sys, threading, texnet.cli\n"
        "from concurrent.futures import ThreadPoolExecutor\n"
        "sys.argv = ['texnet', 'library', 'list']\n"
        "texnet.cli.GRACE_S = 1\n"
        "texnet.cli.main()\n"
        "with ThreadPoolExecutor(1) as beside:\n"
        "    beside.submit(threading.Event().wait)\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    words = [sys.executable, "-c", code]
    assert subprocess.run(words, cwd=ROOT, capture_output=True).returncode == -signal.SIGALRM


@pytest.mark.skipif(os.name != "posix", reason="tells by signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_what_is_half_written_goes_when_the_process_is_told_to_end(tmp_path, name):
    """As schedulers and `timeout` tell it, by SIGTERM, and a terminal that closes, by SIGHUP."""
    code = (
        "import os, signal, sys, texnet.cli\n"
        "from pathlib import Path\n"
        "from physics.machinery.whole_file import whole_file\n"
        "sys.argv = ['texnet', 'library', 'list']\n"
        "texnet.cli.main()\n"
        f"with whole_file(Path({str(tmp_path / 'a.txt')!r})) as part:\n"
        "    Path(part).write_text('half')\n"
        f"    os.kill(os.getpid(), signal.{name})\n"
    )
    heard = lambda: signal.signal(getattr(signal, name), signal.SIG_DFL)  # where nohup ignores it
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, preexec_fn=heard)
    assert done.returncode == 128 + getattr(signal, name) and list(tmp_path.iterdir()) == []
