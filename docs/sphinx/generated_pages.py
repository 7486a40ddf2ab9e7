# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Pages made from the code whenever the site is built: commands, configuration, the notebook."""

import json
import re
from pathlib import Path
from types import NoneType
from typing import Any, get_args

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx

from gtmr_model import OneOfKinds, Vehicle
from gtmr_nmpc import ControllerConfig
from gtmr_sim import Scenario, World
from gtmr_study.cli.app import app as command_line

ROOT = Path(__file__).parents[2]
FILES: dict[str, tuple[type[BaseModel], ...]] = {
    "vehicle": (Vehicle,),
    "controller": (ControllerConfig,),
    "scenario": (Scenario,),
    "world": (World,),
}
"""Kinds of configuration files, by their folder in config/."""


def commands() -> str:
    """Describe every command with its options, in Markdown."""
    group: Any = typer.main.get_group(command_line)
    parts = []
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        context = command.make_context(f"gtmr {name}", [], resilient_parsing=True)
        usage = " ".join([f"gtmr {name}", *command.collect_usage_pieces(context)])
        rows = [row for p in command.params if (row := p.get_help_record(context)) is not None]
        parts += [f"## gtmr {name}", paragraphs(command.help or ""), f"```text\n{usage}\n```"]
        if rows:
            lines = [f"| `{cell(names)}` | {cell(told)} |" for names, told in rows]
            parts.append("| option | meaning |\n| --- | --- |\n" + "\n".join(lines))
    return "\n\n".join(parts)


def paragraphs(help_text: str) -> str:
    """Make Markdown of a command's help."""
    return markdown("\n".join(line.strip() for line in help_text.replace("\b", "").splitlines()))


def configuration() -> str:
    """Describe the fields of every kind of configuration file, in Markdown."""
    parts: list[str] = []
    described: list[type[BaseModel]] = []
    for kind, models in FILES.items():
        presets = sorted(path.stem for path in (ROOT / "config" / kind).glob("*.yaml"))
        parts.append(f"## {kind.capitalize()}")
        parts.append(
            f"Presets, in [config/{kind}](../../config/{kind}): "
            + ", ".join(f"`{name}`" for name in presets) + "."
        )  # fmt: skip
        todo = list(models)
        while todo:
            model = todo.pop(0)
            if model not in described:
                described.append(model)
                if model not in models:
                    parts.append(f"### {model.__name__}")
                parts += [markdown(first_line(model)), fields(model)]
                todo += [
                    each for f in model.model_fields.values() for each in within(f.annotation)
                ]
    return "\n\n".join(parts)


def within(annotation: Any) -> list[type[BaseModel]]:
    """List the models in a type; those of a family instead of the family."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if OneOfKinds in annotation.__bases__:
            return list(annotation._members.values())
        return [annotation]
    return [model for part in get_args(annotation) for model in within(part)]


def fields(model: type[BaseModel]) -> str:
    """Make a table of the fields of a model."""
    rows = [
        f"| `{name}` | {default(field)} | {cell(allowed(field))} | "
        f"{cell(markdown(field.description or ''))} |"
        for name, field in model.model_fields.items()
    ]
    head = "| field | default | allowed | meaning and unit |\n| --- | --- | --- | --- |"
    return "\n".join([head, *rows])


def default(field: FieldInfo) -> str:
    """Say what a field is if it is left out."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=not field.default_factory_takes_validated_data)
    models = within(field.annotation)
    if isinstance(value, OneOfKinds):
        return f"`{value.kind}`"
    if isinstance(value, Vehicle):
        return "`paper`"
    if isinstance(value, BaseModel) or (models and value not in (None, ())):
        return "below"
    if value is None:
        return "none" if NoneType in get_args(field.annotation) else ""
    return f"`{json.dumps(value)}`"


def allowed(field: FieldInfo) -> str:
    """Say which values a field may have."""
    signs = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    told = [
        f"{word} {getattr(limit, sign):g}"
        for limit in field.metadata
        for sign, word in signs.items()
        if isinstance(getattr(limit, sign, None), (int, float))
    ]
    choices = [each for each in get_args(field.annotation) if isinstance(each, str)]
    told += [", ".join(f"`{choice}`" for choice in choices)] if choices else []
    return ", ".join(told)


def first_line(model: type[BaseModel]) -> str:
    """First paragraph of a model's docstring."""
    return " ".join((model.__doc__ or "").partition("\n\n")[0].split())


def markdown(text: str) -> str:
    """Make Markdown of a docstring's quotes, and keep signs that would mean something there."""
    parts = re.split(r"(``.+?``|`.+?`)", text)
    return "".join(
        f"`{part.strip('`')}`" if part.startswith("`") else re.sub(r"([*<$_\[\]])", r"\\\1", part)
        for part in parts
    )


def cell(text: str) -> str:
    """Put a text into a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


def notebook() -> str:
    """Show the cells of the notebook that reads a bag, in Markdown."""
    cells = json.loads((ROOT / "examples" / "read_a_bag.ipynb").read_text("utf-8"))["cells"]
    shown = ("".join(each["source"]) for each in cells)
    return "\n\n".join(
        f"```python\n{text}\n```" if each["cell_type"] == "code" else text
        for each, text in zip(cells, shown, strict=True)
    )


def examples() -> str:
    """Take over the index of the examples; its links lead to the same from the tutorials."""
    text = (ROOT / "examples" / "README.md").read_text("utf-8").partition("\n")[2]
    text = re.sub(r"`python (examples/\w+\.py)`", r"[`python \1`](../../\1)", text)
    return text.replace("](../docs/tutorials/", "](").replace("](../docs/", "](../")


MADE = {
    "reference/command-line": commands,
    "reference/configuration": configuration,
    "tutorials/notebook": notebook,
    "tutorials/examples": examples,
}
"""What is added to which page."""


def add(app: Sphinx, page: str, source: list[str]) -> None:
    """Add what is made to what a page says itself, and a title to tables that have none."""
    if page.startswith("reproduction/"):
        _, preset, table = page.split("/")
        source[0] = f"---\norphan: true\n---\n\n# {table.capitalize()}, {preset}\n\n{source[0]}"
    if page in MADE:
        source[0] += "\n" + MADE[page]() + "\n"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("source-read", add)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
