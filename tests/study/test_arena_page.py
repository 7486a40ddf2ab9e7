# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The page of an arena: whom to take, why, and every point's trials; for everybody."""

import re

import pytest
from support import arena_runs
from support.pages import needs_chromium, opened, require_for_everybody, wait_until_drawn

from gtmr_study.arena.page import write_arena
from gtmr_study.arena.run import fly_arena

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Folder and results of an arena whose flights are long enough to have settled."""
    folder = tmp_path_factory.mktemp("page")
    own = arena_runs.own_controllers(folder)[1:2]
    arena = arena_runs.plan(own, duration_s=6.0, worlds=("paper", "field"))
    fly_arena(arena, folder / "out", own, 2)
    return folder / "out", write_arena(folder / "out", own)


def test_the_page_says_whom_to_take_in_each_world_and_why(written):
    folder, results = written
    text = (folder / "arena.html").read_text(encoding="utf-8")
    seen = re.sub(r"<[^>]+>", "", re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))
    assert seen.count("offset_free at 0.25 m") >= 2
    assert "World field: take" in seen
    assert "0 of 3 violate (below 56.1&nbsp;% with 95&nbsp;% confidence)" in seen
    assert "ValueError" not in seen
    assert "nan among" in seen
    assert "3 in error" in seen
    assert "The guard is off" in " ".join(seen.split())
    listed = re.findall(r'href="(worst/[^"]+)"', text)
    assert len(listed) == sum(result["trials"] > 0 for result in results)
    assert all((folder / file).is_file() for file in listed)


@needs_chromium
def test_everybody_can_read_it_and_a_point_shows_its_trials(written, axe):
    folder, results = written
    name = "nominal at 0.35 m"
    with opened(folder / "arena.html") as page:
        wait_until_drawn(page)
        page.wait_until(lambda: page.evaluate("document.documentElement.dataset.trials"))
        trials, commands = trials_in(page, 0)
        assert len(trials) == 3
        assert all("worst/paper/offset_free-0.25-" in command for command in commands)

        page.evaluate(
            "document.getElementById('world-1-0').emit('plotly_hover', "
            f"{{points: [{{customdata: '{name}'}}]}})"
        )
        page.wait_until(lambda: trials_in(page, 1)[1][0].find("worst/field/nominal-0.35") > 0)
        least_m = min(trials_in(page, 1)[0])
        told = next(r for r in results if (r["controller"], r["world"], r["d_ref_m"])
                    == ("nominal", "field", 0.35))  # fmt: skip
        assert least_m == pytest.approx(told["min_clearance_m"], abs=1e-4)

        page.evaluate(
            "(() => { const chosen = document.getElementById('cell-1');"
            " chosen.value = 'offset_free at 0.35 m';"
            " chosen.dispatchEvent(new Event('change')); })()"
        )
        page.wait_until(lambda: trials_in(page, 1)[1][0].find("field/offset_free-0.35") > 0)
        assert trials_in(page, 0)[1] == commands
        page.evaluate("document.querySelectorAll('details').forEach((each) => each.open = true)")
        require_for_everybody(page, axe)


def trials_in(page, number):
    """Least clearances that the chart of trials shows, and the commands below it."""
    least_m = page.evaluate(f"document.getElementById('world-{number}-1').data[0].y")
    commands = page.evaluate(
        f"[...document.querySelectorAll('#worst-{number} code')].map((each) => each.textContent)"
    )
    return least_m, commands
