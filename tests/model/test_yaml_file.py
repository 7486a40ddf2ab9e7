# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Whatever a YAML file holds, it is read or refused in one line, and soon."""

import os
from importlib.resources import files
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from gtmr_model import ConfigError, Helix, Tower, UncertaintySet, Vehicle
from gtmr_model.yaml_file import MAX_BYTES, MAX_DEPTH, MAX_VALUES, parse_yaml, read_yaml
from gtmr_nmpc import ControllerConfig
from gtmr_sim import Scenario, World
from gtmr_study.campaign.study import Study

MODELS = (ControllerConfig, Helix, Scenario, Study, Tower, UncertaintySet, Vehicle, World)
PRESETS = sorted(Path(str(files("gtmr_model") / "config")).glob("*/*.yaml"))
LAUGHS = "a0: &a0 [x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
)

HOSTILE = {
    "aliases of aliases": (LAUGHS, "more than 10000 values"),
    "merges of merges": (LAUGHS.replace("[x]", "{k: 1}").replace(": [", ": {<<: ["), "YAML"),
    "a chain of aliases": (
        "".join(f"- &a{i} [{f'*a{i - 1}' if i else 1}]\n" for i in range(MAX_DEPTH)),
        "more than 20 levels",
    ),
    "an alias of itself": ("a: &a [*a]", "an alias within what it stands for"),
    "deep lists": ("[" * 5000, "more than 20 levels"),
    "deep mappings": ("".join(" " * i + "a:\n" for i in range(700)), "more than 20 levels"),
    "many values": ("- 1\n" * (MAX_VALUES + 1), "more than 10000 values"),
    "a key twice": ("mass_kg: 1.0\nmass_kg: 2.0", "'mass_kg' is there twice"),
    "code": ("!!python/object/apply:os.system [touch x]", "could not determine a constructor"),
    "a yes that is none": ("a: !!bool maybe", "not a YAML file"),
    "a date that is none": ("a: !!timestamp soon", "not a YAML file"),
    "a number without digits": ("a: 0x_", "not a YAML file"),
    "an empty number": ("a: !!int ''", "not a YAML file"),
    "a number of many digits": ("a: " + "9" * 5000, "not a YAML file"),
    "a number in base 60": ("a: " + ":".join(["1"] * 200) + ".5", "not a YAML file"),
    "a list as key": ("? [a]\n: b", "unhashable key"),
    "two documents": ("--- 1\n--- 2", "single document"),
    "a control character": ("a: \x00", "special characters"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_yaml_is_refused_in_one_line(case, tmp_path):
    text, reason = HOSTILE[case]
    file = tmp_path / "hostile.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=reason) as refused:
        Vehicle.from_yaml(file)
    assert "\n" not in str(refused.value)


def test_a_long_file_is_refused_before_it_is_read(tmp_path):
    file = tmp_path / "long.yaml"
    with file.open("wb") as stream:
        stream.truncate(1 << 40)
    with pytest.raises(ConfigError, match=f"more than the {MAX_BYTES // 1024} KiB"):
        read_yaml(file)


def test_what_is_no_file_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"\xe9: 1")
    refusals = {
        tmp_path / "pipe.yaml": "is no file",
        tmp_path: "is no file",
        tmp_path / "loop.yaml": "Too many levels of symbolic links",
        tmp_path / ("x" * 300 + ".yaml"): "File name too long",
        tmp_path / "latin.yaml": "not a YAML file: 'utf-8' codec can't decode",
        Path("/dev/zero"): "is no file",
        tmp_path / "none.yaml" / "none": "No such file",
    }
    for path, reason in refusals.items():
        with pytest.raises(ConfigError, match=reason):
            read_yaml(path)


def test_aliases_and_merges_within_bounds_are_followed():
    text = "base: &base {x: 1, y: [2, no]}\nother: {<<: *base, x: 3, when: 2026-01-01}"
    base = {"x": 1, "y": [2, False]}
    assert parse_yaml(text, "here") == {
        "base": base,
        "other": base | {"x": 3, "when": "2026-01-01"},
    }


@pytest.mark.parametrize("path", PRESETS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_what_comes_with_the_suite_is_read_as_ever(path):
    # Tags of launch_ros stand in none of them.
    assert read_yaml(path) == yaml.safe_load(path.read_text())


def test_a_wrong_value_is_shown_in_short_and_on_one_line():
    wrong = {f"no\nsuch {i}": "x" * 10_000 for i in range(1000)} | {"mass_kg": "y" * 10_000}
    with pytest.raises(ConfigError, match="and 998 more") as refused:
        Vehicle.parse(wrong, "here")
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 2000


SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from([10**400, -(10**400), 1e308, 5e-324, "paper", "nan", "1e999"]),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=6),
        st.dictionaries(st.one_of(st.text(max_size=4), st.integers()), inner, max_size=4),
    ),
    max_leaves=8,
)
EXAMPLES = [yaml.safe_load(path.read_text()) for path in PRESETS if path.parent.name != "ros"]


@st.composite
def documents(draw):
    """A preset with one value in it, at any depth, in the place of another."""
    data = draw(st.sampled_from(EXAMPLES))
    spoilt = draw(VALUES)
    steps = []
    here = data
    while isinstance(here, dict | list) and here and (not steps or draw(st.booleans())):
        step = draw(st.sampled_from(list(here) if isinstance(here, dict) else range(len(here))))
        steps.append(step)
        here = here[step]

    def with_value(part, path):
        if not path:
            return spoilt
        copy = dict(part) if isinstance(part, dict) else list(part)
        copy[path[0]] = with_value(part[path[0]], path[1:])
        return copy

    return with_value(data, steps)


TEXTS = st.one_of(
    st.text(max_size=60),
    st.text(alphabet="[]{}:-?*&!|>'\"%@#,~<=\n\t 01ex._", max_size=60),
    documents().map(yaml.safe_dump),
    st.builds(
        lambda text, at, more: text[:at] + more + text[at:],
        st.sampled_from([path.read_text() for path in PRESETS]),
        st.integers(0, 2000),
        st.text(alphabet="[]{}:-?*&!|>'\"%@#,~<=\n\t 01ex._\x85", max_size=6),
    ),
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.sampled_from(MODELS), TEXTS)
def test_any_text_gives_a_configuration_or_one_line(model, text):
    try:
        model.parse(parse_yaml(text, "any"), "any")
    except ConfigError as refused:
        if "\n" in str(refused):
            raise
