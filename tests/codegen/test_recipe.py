# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A library that is found without generating its sources is the one that they would make."""

import importlib.util
import os
import shutil
import time
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

import gtmr_codegen
import gtmr_model
from gtmr_codegen import library, recipe
from gtmr_codegen.library import load_generated
from gtmr_model import Helix, Rotor, Tower, UncertaintySet, Vehicle, YamlModel
from gtmr_nmpc import Controller, ControllerConfig, Weights
from gtmr_nmpc.compiled import codegen, iteration
from gtmr_nmpc.compiled.iteration import _compiled_part
from gtmr_sim import World, plant
from gtmr_sim.worlds.motors import Motors
from gtmr_sim.worlds.wall import Wall
from gtmr_sim.worlds.wind import Wind

PAPER = ControllerConfig()
SOURCES = {"answer.c": "int answer(void);\nint answer(void)\n{\n    return 42;\n}\n"}


@pytest.fixture(autouse=True)
def settled(monkeypatch):
    """Take the sources as settled, however young the checkout is, and read them anew."""
    later = time.time_ns() + 10 * recipe.SETTLED_NS
    monkeypatch.setattr(gtmr_model, "LOADED_NS", later)
    monkeypatch.setattr(gtmr_codegen, "LOADED_NS", later)
    recipe._generator.cache_clear()
    yield
    recipe._generator.cache_clear()


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "gtmr"


def named(config):
    return recipe.recipe("gtmr_nmpc", _compiled_part(config))


def leaves(model, above=()):
    """Every number and text in a model, by its place."""
    items = enumerate(model) if isinstance(model, tuple) else iter_fields(model)
    for name, value in items:
        if isinstance(value, (YamlModel, tuple)):
            yield from leaves(value, (*above, name))
        else:
            yield (*above, name), value


def iter_fields(model):
    return ((name, getattr(model, name)) for name in type(model).model_fields)


def changed(model, place, value):
    """Give a model with another value at a place; it is not checked."""
    name, *below = place
    if isinstance(model, tuple):
        other = changed(model[name], below, value) if below else value
        return (*model[:name], other, *model[name + 1 :])
    other = changed(getattr(model, name), below, value) if below else value
    return model.model_copy(update={name: other})


def another(value):
    match value:
        case bool():
            return not value
        case str():
            return f"{value}x"
        case int():
            return value + 1
        case None:
            return 1.0
        case _:
            return float(np.nextafter(value, np.inf))


WORLD = World(motors=Motors(lag_s=0.02), wind=Wind(), wall=Wall(suction_n=0.5))
GIVEN = {
    "vehicle": Vehicle.paper(),
    "tower": Tower(),
    "helix": Helix(),
    "uncertainty": UncertaintySet(),
    "controller": PAPER,
    "world": WORLD,
}


@pytest.mark.parametrize("what", GIVEN)
def test_any_field_that_a_generator_is_given_makes_another_recipe(what):
    given = GIVEN[what]
    package = "gtmr_sim" if what == "world" else "gtmr_nmpc"
    recipes = {recipe.recipe(package, given)}
    places = list(leaves(given))
    for place, value in places:
        # The least change of a number that there is.
        recipes.add(recipe.recipe(package, changed(given, place, another(value))))
    assert None not in recipes
    assert len(recipes) == 1 + len(places)


@pytest.mark.slow
def test_a_field_that_changes_the_sources_changes_the_recipe():
    text = codegen.c_sources(_compiled_part(PAPER))
    told = 0
    for place, value in leaves(PAPER):
        if isinstance(value, str) or value is None:
            continue
        other = changed(PAPER, place, value + 1 if type(value) is int else 1.01 * value + 0.001)
        if named(other) == named(PAPER):
            # All of what is not in the recipe is in `gtmr_parameters`, and in no source.
            assert _compiled_part(other) == _compiled_part(PAPER), place
        else:
            told += codegen.c_sources(_compiled_part(other)) != text
    assert told > 30


def test_the_numbers_that_are_read_at_run_time_share_one_library():
    same = (
        {"tower": Tower(radius_m=2.0)},
        {"helix": Helix(offset_m=0.5)},
        {"weights": Weights(yaw=1.0)},
        {"uncertainty": UncertaintySet(mass=0.05)},
    )
    assert {named(ControllerConfig(**each)) for each in same} == {named(PAPER)}


def test_what_differs_in_class_alone_is_another_recipe():
    class Model(YamlModel):
        mass: float = 1.0

    Model.__module__ = "gtmr_nmpc.one"
    Model.__qualname__ = "Model"
    first = recipe.recipe("gtmr_nmpc", Model())
    Model.__qualname__ = "Other"
    assert None is not first != recipe.recipe("gtmr_nmpc", Model())


class Mine(Helix):
    """A path of one's own; what it does is in no file of the suite's."""

    kind: str = "mine-in-a-test"


class Odd(float):
    def __repr__(self):
        return "1.0"


def test_there_is_no_recipe_of_what_somebody_else_brings():
    assert named(ControllerConfig(helix=Mine())) is None
    assert recipe.recipe("gtmr_nmpc", Odd(2.0)) is None
    assert recipe.recipe("gtmr_nmpc", lambda: 0) is None
    assert recipe.recipe("gtmr_nmpc", np.zeros(3)) is None
    rotor = Rotor.model_construct(position_m=(0.0, 0.0, np.zeros(1)), spin="cw")
    assert recipe.recipe("gtmr_nmpc", rotor) is None


@pytest.fixture
def copies(tmp_path, monkeypatch):
    """Copies of all that generates, in place of the packages."""
    folders = {}
    for name in (*recipe.PACKAGES, "gtmr_nmpc"):
        folders[name] = tmp_path / name
        source = Path(importlib.util.find_spec(name).origin).parent
        shutil.copytree(source, folders[name], ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(recipe, "_folder", folders.__getitem__)
    return folders


def fresh():
    recipe._generator.cache_clear()
    return named(PAPER)


def test_any_byte_of_any_source_of_the_generator_makes_another_recipe(copies):
    before = fresh()
    sources = [
        path
        for folder in copies.values()
        for path in folder.rglob("*")
        if path.suffix in (".py", ".c", ".h")
    ]
    names = {path.name for path in sources}
    assert {"codegen.py", "c_source.py", "dynamics.py", "vec.h", "gtmr.h", "ocp.py"} <= names
    for path in sources:
        content = path.read_bytes()
        place = len(content) // 2
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        assert fresh() not in (None, before), path
        path.write_bytes(content)
    assert fresh() == before


def test_a_source_that_comes_goes_or_is_renamed_makes_another_recipe(copies):
    before = fresh()
    folder = copies["gtmr_nmpc"] / "compiled"
    (folder / "more.py").write_text("")
    assert fresh() not in (None, before)
    (folder / "more.py").unlink()
    (folder / "codegen.py").rename(folder / "codegem.py")
    assert fresh() not in (None, before)
    (folder / "codegem.py").unlink()
    assert fresh() not in (None, before)


@pytest.mark.parametrize("clock", ["content", "name"])
def test_there_is_no_recipe_where_a_source_changed_after_it_was_imported(
    clock, copies, monkeypatch
):
    loaded = time.time_ns() + 2 * recipe.SETTLED_NS
    monkeypatch.setattr(gtmr_model, "LOADED_NS", loaded)
    assert fresh() is not None
    path = copies["gtmr_model"] / "tower.py"
    if clock == "content":
        os.utime(path, ns=(loaded, loaded))
    else:
        # As a file that was moved here: its content is old, its place is new.
        monkeypatch.setattr(gtmr_model, "LOADED_NS", time.time_ns() + recipe.SETTLED_NS // 2)
        for each in (each for folder in copies.values() for each in folder.rglob("*")):
            os.utime(each, ns=(0, 0))
    assert fresh() is None


@pytest.mark.parametrize("what", ["version", "none", "NumPy", "compiler flags"])
def test_other_tools_make_another_recipe_or_none(what, monkeypatch):
    before = fresh()
    if what == "version":
        monkeypatch.setattr(metadata, "version", lambda _: "0.0")
    elif what == "NumPy":
        monkeypatch.setattr(np, "__version__", "0.0")
    elif what == "compiler flags":
        flagged = (_compiled_part(PAPER), ("-O0",))
        assert recipe.recipe("gtmr_nmpc", *flagged) != before
        return
    else:
        monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
        assert fresh() is None
        return
    assert fresh() not in (None, before)


def test_what_was_made_once_is_found_without_generating_it(cache):
    made = []

    def make():
        made.append(1)
        return SOURCES, {}

    answers = [load_generated("a test", "gtmr_nmpc", (1,), make).answer() for _ in range(2)]
    assert answers == [42, 42]
    assert len(made) == 1
    # Two names of one file, of the text and of the recipe.
    entries = list(cache.glob("*.so"))
    assert len(entries) == 2
    assert len({entry.stat().st_ino for entry in entries}) == 1


def test_other_values_do_not_find_it(cache):
    for value in (1, 2, 1.0, True, "1", (1,)):
        other = {"answer.c": SOURCES["answer.c"].replace("42", str(len(list(cache.glob("*")))))}
        expected = int(other["answer.c"].partition("return ")[2].partition(";")[0])
        found = load_generated("a test", "gtmr_nmpc", (value,), lambda other=other: (other, {}))
        assert found.answer() == expected, value


def test_without_a_recipe_it_is_found_by_its_text(cache):
    made = []

    def make():
        made.append(1)
        return SOURCES, {}

    for _ in range(2):
        assert load_generated("a test", "gtmr_nmpc", (np.zeros(1),), make).answer() == 42
    assert len(made) == 2
    assert len(list(cache.glob("*.so"))) == 1


def test_a_generator_that_changes_while_it_generates_leaves_no_recipe(cache, copies):
    recipe._generator.cache_clear()

    def make():
        path = copies["gtmr_nmpc"] / "ocp.py"
        path.write_text(path.read_text() + "\n")
        return SOURCES, {}

    assert load_generated("a test", "gtmr_nmpc", (1,), make).answer() == 42
    assert len(list(cache.glob("*.so"))) == 1


@pytest.mark.parametrize("harm", ["exchanged", "writable by others", "a link"])
def test_an_entry_under_a_recipe_is_checked_like_any_other(harm, cache, tmp_path):
    def load():
        return load_generated("a test", "gtmr_nmpc", (1,), lambda: (SOURCES, {})).answer()

    load()
    good = next(cache.glob("*.so")).read_bytes()
    for entry in cache.glob("*.so"):
        entry.unlink()
        if harm == "a link":
            (tmp_path / "else.so").write_bytes(good)
            entry.symlink_to(tmp_path / "else.so")
            continue
        bad = good.replace(b"\x2a\x00\x00\x00", b"\x2b\x00\x00\x00")
        entry.write_bytes(bad if harm == "exchanged" else good)
        entry.chmod(0o666 if harm == "writable by others" else 0o600)
    assert load() == 42
    assert all(entry.read_bytes() == good and not entry.is_symlink() for entry in cache.glob("*"))


PROBLEMS = {
    "octo": {"vehicle": "octo", "horizon": 5},
    "short": {"horizon": 4},
    "slow": {"sampling_time_s": 0.05, "horizon": 4},
    "airframe": {"clearance_of": "airframe", "horizon": 4},
}


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
def test_the_library_of_a_recipe_is_that_of_its_sources(cache, monkeypatch):
    configs = {name: ControllerConfig.parse(fields, name) for name, fields in PROBLEMS.items()}
    for config in configs.values():
        iteration._library.cache_clear()
        Controller(config)
    plans = {}
    for name, config in configs.items():
        iteration._library.cache_clear()
        with monkeypatch.context() as patch:
            patch.setattr(codegen, "c_sources", lambda _: pytest.fail("generated again"))
            controller = Controller(config)
        x = config.helix.initial_state(config.tower, config.vehicle)
        plans[name] = controller.step(0.0, x).u_plan
    by_recipe = {p.name.partition("-")[2] for p in cache.glob("*.so")}
    # From scratch, by the text alone.
    shutil.rmtree(cache)
    monkeypatch.setattr(library, "recipe", lambda *_: None)
    for name, config in configs.items():
        iteration._library.cache_clear()
        x = config.helix.initial_state(config.tower, config.vehicle)
        np.testing.assert_array_equal(Controller(config).step(0.0, x).u_plan, plans[name])
    assert {p.name.partition("-")[2] for p in cache.glob("*.so")} == by_recipe
    iteration._library.cache_clear()


@pytest.mark.parametrize("world", [World(), WORLD], ids=["paper", "with effects"])
def test_the_plant_of_a_recipe_is_that_of_its_sources(world, cache, monkeypatch):
    given = (Vehicle.paper(), 1e-3, Tower(), (), world.in_plant)
    plant._integrator.cache_clear()
    plant._integrator(*given)
    by_recipe = {p.name.partition("-")[2] for p in cache.glob("*.so")}
    with monkeypatch.context() as patch:
        patch.setattr(plant, "_plant_step", lambda *_: pytest.fail("generated again"))
        plant._integrator.cache_clear()
        plant._integrator(*given)
    shutil.rmtree(cache)
    plant._compiled(plant._plant_step(*given))
    assert {p.name.partition("-")[2] for p in cache.glob("*.so")} == by_recipe
    plant._integrator.cache_clear()
