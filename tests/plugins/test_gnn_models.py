"""Model files: what is written comes back, and what is not valid is refused with the reason."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings, strategies as st

from agglo_core import FileError, OptionError
from agglo_core.errors import AggloError, PluginError
from agglo_gnn import model_file
from agglo_gnn.model import model
from agglo_gnn.training.command import train

pytest.importorskip("safetensors")

HEADER = {
    "architecture": "toy",
    "features": ["x", "y"],
    "recipe": {"meshes": 3},
    "seed": 4,
    "version": "0",
    "metrics": {"loss": 0.25},
}
ARRAYS = {
    "w": np.arange(6, dtype=np.float32).reshape(2, 3),
    "count": np.array(7, np.int64),
    "turned": np.arange(6.0).reshape(2, 3).T,
}
SHAPES = {"w": (2, 3), "b": (3,)}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "toy.safetensors"
    model_file.save(path, ARRAYS, HEADER)
    return path


def refused(path, reason, **wanted):
    with pytest.raises(FileError, match=reason) as caught:
        model_file.load(path, **wanted)
    assert str(path) in str(caught.value)


def test_what_is_saved_comes_back(file):
    arrays, header = model_file.load(file, architecture="toy")
    assert {name: array.dtype for name, array in arrays.items()} == {k: v.dtype for k, v in ARRAYS.items()}
    assert all(np.array_equal(arrays[name], ARRAYS[name]) for name in ARRAYS)
    assert {key: header[key] for key in HEADER} == HEADER
    assert header["arrays"]["turned"] == ["float64", [3, 2]]
    assert model_file.read_header(file) == header


def test_the_same_model_is_the_same_file(file, tmp_path):
    again = tmp_path / "again.safetensors"
    model_file.save(again, dict(reversed(ARRAYS.items())), dict(reversed(HEADER.items())))
    assert again.read_bytes() == file.read_bytes()


def test_a_file_that_cannot_be_written_leaves_the_old_one(file):
    before = file.read_bytes()
    with pytest.raises(FileError, match="not plain data"):
        model_file.save(file, ARRAYS, HEADER | {"metrics": {"loss": float("nan")}})
    with pytest.raises(FileError, match="lacks seed, metrics"):
        model_file.save(file, ARRAYS, {k: v for k, v in HEADER.items() if k not in ("seed", "metrics")})
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("name", ["model.pt", "model", "no folder/model.safetensors"])
def test_names_that_cannot_be_written(tmp_path, name):
    with pytest.raises(FileError, match=r"end in .safetensors|cannot be written"):
        model_file.save(tmp_path / name, ARRAYS, HEADER)


def test_another_architecture_is_refused(file):
    refused(file, "is a model of 'toy', expected 'paper'", architecture="paper")


@pytest.mark.parametrize(
    ("shapes", "reason"),
    [
        ({"w": (2, 3)}, "unknown array 'b'"),
        ({**SHAPES, "c": (1,)}, "lacks array 'c'"),
        (
            {**SHAPES, "w": (3, 2)},
            r"'w' is float32 of shape \(2, 3\), expected real numbers of shape \(3, 2\)",
        ),
    ],
)
def test_other_arrays_are_refused(tmp_path, shapes, reason):
    path = tmp_path / "a.safetensors"
    model_file.save(path, {"w": ARRAYS["w"], "b": np.zeros(3)}, HEADER)
    model_file.load(path, shapes=SHAPES)
    refused(path, reason, shapes=shapes)


def test_other_types_are_refused(tmp_path):
    path = tmp_path / "a.safetensors"
    model_file.save(path, {"w": ARRAYS["w"].astype(np.int32), "b": np.zeros(3)}, HEADER)
    refused(path, "'w' is int32", shapes=SHAPES)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(tmp_path, bad):
    path = tmp_path / "a.safetensors"
    model_file.save(path, {"w": np.array([1.0, bad])}, HEADER)
    refused(path, "'w' has values that are not finite")


def test_a_pickle_is_refused_unread(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "exploded",))

    path = tmp_path / "bomb.safetensors"
    for protocol in (2, 5):
        path.write_bytes(pickle.dumps(Bomb(), protocol=protocol))
        refused(path, "is a pickle")
    path.write_bytes(b"PK\x03\x04 as torch.save begins")
    refused(path, "is a pickle or zip file")
    assert not (tmp_path / "exploded").exists()


def test_a_missing_file_and_a_folder(tmp_path):
    refused(tmp_path / "none.safetensors", "cannot be read: No such file")
    refused(tmp_path, "cannot be read: Is a directory")


def test_safetensors_of_others_are_refused(tmp_path):
    from safetensors.numpy import save_file

    path = tmp_path / "theirs.safetensors"
    save_file({"w": np.zeros(3)}, path)
    refused(path, "no header of an agglo model")
    save_file({"w": np.zeros(3)}, path, metadata={"agglo": "[1, 2]"})
    refused(path, "header")
    save_file({"w": np.zeros(3)}, path, metadata={"agglo": json.dumps(HEADER)})
    refused(path, "lacks arrays, sha256")


@settings(max_examples=25)
@given(st.data())
def test_cut_short_or_changed_anywhere_it_is_refused(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("broken") / "toy.safetensors"
    model_file.save(path, ARRAYS, HEADER)
    valid = path.read_bytes()
    if data.draw(st.booleans(), label="cut"):
        broken = valid[: data.draw(st.integers(0, len(valid) - 1), label="length")]
        path.write_bytes(broken)
        refused(path, "truncated|corrupt|header|pickle")
        return
    place = data.draw(st.integers(len(valid) - 76, len(valid) - 1), label="place")  # among the arrays
    bit = 1 << data.draw(st.integers(0, 7), label="bit")
    path.write_bytes(valid[:place] + bytes([valid[place] ^ bit]) + valid[place + 1 :])
    refused(path, "corrupt")


def test_info_shows_what_is_in_a_file(file):
    done = CliRunner().invoke(model, ["info", str(file)])
    assert done.exit_code == 0
    for word in ("architecture toy", "13 numbers", "meshes 3", "loss 0.25", "seed         4"):
        assert word in done.output
    as_json = json.loads(CliRunner().invoke(model, ["info", "--json", str(file)]).output)
    assert as_json == model_file.read_header(file)


def test_info_refuses_what_is_no_model(tmp_path):
    path = tmp_path / "x.safetensors"
    path.write_text("no model")
    done = CliRunner().invoke(model, ["info", str(path)])
    assert isinstance(done.exception, FileError)


def failure(arguments):
    done = CliRunner().invoke(train, [str(argument) for argument in arguments])
    assert isinstance(done.exception, AggloError), done.output
    return str(done.exception)


def test_training_without_torch_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "torch", None)
    for preset in ("paper", "fast"):
        message = failure(["--preset", preset])
        assert "PyTorch" in message
        assert "pip install 'agglo[train]'" in message


def test_files_without_safetensors_say_what_to_install(monkeypatch, file):
    monkeypatch.setitem(sys.modules, "safetensors", None)
    with pytest.raises(PluginError, match=r"safetensors.*pip install 'agglo\[gnn\]'"):
        model_file.load(file)
    with pytest.raises(PluginError, match="safetensors"):
        model_file.save(file, ARRAYS, HEADER)


def test_training_refuses_before_it_begins_what_would_fail_after(monkeypatch, tmp_path):
    pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    paper = ["--preset", "paper"]
    assert "end in .safetensors" in failure([*paper, "-o", "weights.pt"])
    assert "end in .safetensors" in failure([*paper, "--checkpoint", "c.pt"])
    assert "no folder" in failure([*paper, "-o", "none/weights.safetensors"])
    assert "no folder" in failure([*paper, "--log", "none/weights.log"])
    assert "same file" in failure([*paper, "-o", "a.safetensors", "--checkpoint", "a.safetensors"])
    assert "--resume needs --checkpoint" in failure([*paper, "--resume"])
    assert "--steps: not for the preset paper" in failure([*paper, "--steps", 3])
    assert "--epochs, --rate: not for the preset fast" in failure(["--rate", 0.1, "--epochs", 3])
    assert "module:Class" in failure([*paper, "--network", "mine"])
    assert "cannot be imported" in failure([*paper, "--network", "no_such_module:Net"])
    assert list(tmp_path.iterdir()) == []


def test_options_that_make_no_sense_are_usage_errors():
    for arguments in (["--epochs", "0"], ["--pieces", "2"], ["--rate", "0"], ["--preset", "slow"]):
        assert CliRunner().invoke(train, arguments).exit_code == 2


def test_cuda_is_refused_where_there_is_none(monkeypatch):
    torch = pytest.importorskip("torch")
    from agglo_gnn.paper.epochs import choose_device

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_device("auto") == "cpu"
    with pytest.raises(OptionError, match="no CUDA device"):
        choose_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert choose_device("auto") == "cuda"
