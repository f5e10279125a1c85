"""The configuration: defaults, file, options; what is wrong is named with its place."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from folders import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser import __version__
from localiser.config import Config, in_force, read_config, to_yaml
from localiser.errors import InputError

CONFIGS = ROOT / "configs"


def write(folder: Path, text: str) -> Path:
    (folder / "config.yaml").write_text(text)
    return folder / "config.yaml"


def test_later_sources_win_and_leave_the_rest_alone(tmp_path: Path) -> None:
    path = write(tmp_path, "mcl: {particles: 300}\nmotion:\n  alpha1: 1e-3\n  alpha2: 2e-3\n")
    config = read_config(
        path, ["motion.alpha2=5e-3", "seed=1", "seed = 2"], {"motion.alpha1": 9e-3, "mcl.resample_below": 0.25}
    )
    assert config.seed == 2
    assert (config.mcl.particles, config.mcl.resample_below) == (300, 0.25)
    assert (config.motion.alpha1, config.motion.alpha2) == (1e-3, 5e-3)
    assert config.motion.alpha3 == Config().motion.alpha3


@pytest.mark.parametrize("text", ["", "# nothing\n", "mcl: {}\n"])
def test_file_that_says_nothing_changes_nothing(tmp_path: Path, text: str) -> None:
    assert read_config(write(tmp_path, text)) == read_config() == Config()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("mcl:\n  particels: 3\n", "config.yaml:2:3: mcl.particels: unknown key; the nearest known is 'particles'"),
        ("mlc: {}\n", "config.yaml:1:1: mlc: unknown key; the nearest known is 'mcl'"),
        ("motion: {}\nmcl: {particles: 0}\n", "config.yaml:2:7: mcl.particles: expected greater than or equal to 1"),
        ("mcl: {particles: 1.5}\n", "config.yaml:1:7: mcl.particles: expected a valid integer"),
        ("motion: {alpha1: .inf}\n", "config.yaml:1:10: motion.alpha1: expected a finite number, found inf"),
        ("observation: {kind: slop}\n", "observation.kind: expected 'line' or 'slope', found 'slop'"),
        ("observation:\n  sight: {range_mx_m: 3}\n", "config.yaml:2:11: observation.sight.range_mx_m: unknown key"),
        ("mcl: 5\n", "config.yaml:1:1: mcl: expected keys and values, found 5"),
        ("seed: -1\n", "config.yaml:1:1: seed: expected greater than or equal to 0, found -1"),
        ("seed: 1\nseed: 2\n", "config.yaml:2:1: seed: given twice"),
        ("- seed\n", "config.yaml:1:1: expected sections and values, found ['seed']"),
    ],
)
def test_errors_of_a_file_name_line_column_and_field(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        read_config(write(tmp_path, text))
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ("mcl.particels=3", "--set mcl.particels=3: mcl.particels: unknown key; the nearest known is 'particles'"),
        ("mcl.particles=-3", "--set mcl.particles=-3: mcl.particles: expected greater than or equal to 1, found -3"),
        ("mcl={particls: 3}", "--set mcl={particls: 3}: mcl.particls: unknown key; the nearest known is 'particles'"),
        ("mcl.particles=[", "--set mcl.particles=[: not valid YAML"),
        ("mcl.particles", "--set mcl.particles: expected section.name=value"),
        ("mcl.particles=", "--set mcl.particles=: expected section.name=value"),
        ("mcl..particles=3", "--set mcl..particles=3: expected section.name=value"),
        ("=3", "--set =3: expected section.name=value"),
        ("seed.x=3", "--set seed.x=3: seed: expected a valid integer"),
        ("seed=yes", "--set seed=yes: seed: expected a number, found true"),
    ],
)
def test_errors_of_an_option_name_the_option(option: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        read_config(None, [option])
    assert str(caught.value).startswith(expected)


def test_place_is_that_of_the_source_the_value_came_from(tmp_path: Path) -> None:
    path = write(tmp_path, "mcl:\n  particles: 3\n  resample_below: 7\n")
    with pytest.raises(InputError, match=r"config\.yaml:3:3: mcl\.resample_below"):
        read_config(path, ["mcl.particles=5"])
    with pytest.raises(InputError, match=r"^--set mcl\.particles=-5: "):
        read_config(write(tmp_path, "mcl:\n  particles: 3\n"), ["mcl.particles=-5"])
    with pytest.raises(InputError, match=r"^the log's own settings: mcl\.particls: unknown key"):
        read_config(None, [], {"mcl.particls": 3})


# -- what is written --------------------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(1, 10**7), st.floats(0, 1e3), st.sampled_from(["line", "slope"]))
def test_config_of_a_run_gives_the_same_run_again(seed: int, particles: int, alpha: float, kind: str) -> None:
    config = read_config(
        None, [f"seed={seed}", f"mcl.particles={particles}", f"motion.alpha1={alpha!r}", f"observation.kind={kind}"]
    )
    assert (config.seed, config.mcl.particles, config.motion.alpha1) == (seed, particles, alpha)
    read_again = Config.model_validate(yaml.safe_load(to_yaml(in_force(config))))
    assert read_again.model_copy(update={"versions": {}}) == config


def test_config_of_a_run_says_what_made_it(tmp_path: Path) -> None:
    config = read_config(write(tmp_path, to_yaml(in_force(Config()))))
    assert config.versions["localiser"] == __version__
    assert set(config.versions) >= {"python", "numpy"}


def leaves(value: Any, key: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    if is_dataclass(value):
        for field in fields(value):
            yield from leaves(getattr(value, field.name), (*key, field.name))
    else:
        yield key


def parameters() -> list[tuple[str, ...]]:
    config = Config()
    return [key for name in Config.model_fields if name != "versions" for key in leaves(getattr(config, name), (name,))]


def test_every_parameter_has_a_meaning_and_is_refused_as_nan() -> None:
    text = to_yaml(Config()).splitlines()
    for key in parameters():
        line = next(place for place, content in enumerate(text) if content.strip().startswith(f"{key[-1]}:"))
        assert text[line - 1].strip().startswith("# "), f"{key} has no description"
        with pytest.raises(InputError):
            read_config(None, [f"{'.'.join(key)}=.nan"])


def test_default_yaml_is_what_config_show_prints() -> None:
    assert (CONFIGS / "default.yaml").read_text() == to_yaml(Config()), "localiser config show > configs/default.yaml"


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.name)
def test_every_shipped_configuration_loads(path: Path) -> None:
    assert isinstance(read_config(path), Config)
