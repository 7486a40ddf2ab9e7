# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The report of a campaign says what its files say, in one file that needs nothing else."""

import itertools
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from gtmr_study.campaign.figures import (
    FIGURES,
    Campaign,
    figures_of,
    why_no_channels,
    write_figures,
)
from gtmr_study.campaign.report import write_campaign_report
from gtmr_study.campaign.trials_file import read_trials
from gtmr_study.result_files import InputError

pytestmark = pytest.mark.slow

COMMITTED = Path(__file__).parents[2] / "docs" / "reproduction" / "default"
CHROMIUM = next(
    (Path(p) for p in ("/usr/bin/chromium", "/usr/bin/google-chrome") if Path(p).exists()), None
)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_the_report_in_a_browser_draws_all_and_asks_for_nothing(flown, tmp_path):
    html, *_ = write_campaign_report([flown], tmp_path / "report.html")
    # The page itself counts what it has loaded.
    count = "document.body.dataset.loaded = performance.getEntriesByType('resource').length"
    page = html.read_text().replace("</body>", f"<script>{count}</script></body>")
    html.write_text(page)
    run = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/p",
         "--no-first-run", "--enable-logging=stderr", "--dump-dom", f"file://{html}"],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip

    for name in set(FIGURES) - {"channels"}:
        assert f'<figure id="{name}"><svg' in run.stdout
    assert "cannot be told from 6 trials" in run.stdout
    assert 'data-loaded="0"' in run.stdout
    assert "CONSOLE" not in run.stderr


def test_a_report_of_a_campaign_that_was_cut_short_says_so(flown, tmp_path):
    part = tmp_path / "part"
    part.mkdir()
    (part / "study.json").write_bytes((flown / "study.json").read_bytes())
    lines = (flown / "trials.csv").read_text().splitlines(keepends=True)
    (part / "trials.csv").write_text("".join(lines[:4]))

    html, *_ = write_campaign_report([part], tmp_path / "report.html")

    assert "9 flights are still missing" in html.read_text()
    assert Campaign.read(part).summary["nominal"]["trials"] == 2


def test_a_report_of_what_is_no_campaign_says_so(tmp_path):
    with pytest.raises(InputError, match="holds no campaign"):
        write_campaign_report([tmp_path], tmp_path / "report.html")
    with pytest.raises(InputError, match="cannot be read"):
        read_trials(tmp_path)


def part_of_committed(folder, trials):
    """The paper's campaign cut to its first trials."""
    folder.mkdir()
    shutil.copy(COMMITTED / "study.json", folder)
    rows = pd.read_csv(COMMITTED / "trials.csv.gz")
    rows[rows["trial"] < trials].to_csv(folder / "trials.csv", index=False)
    return folder


def test_twelve_trials_do_not_tell_what_drives_the_clearance(tmp_path):
    few = part_of_committed(tmp_path / "few", 12)

    html, *figures = write_campaign_report([few], tmp_path / "report.html")

    assert "cannot be told from 12 trials a mode: below 228" in html.read_text()
    assert 'id="channels"' not in html.read_text()
    assert tmp_path / "report-channels.png" not in figures
    assert few / "channels.png" not in write_figures(few)


def test_five_hundred_tell_it_with_intervals_up_to_all_of_it(tmp_path):
    campaign = Campaign.read(part_of_committed(tmp_path / "all", 500))

    assert why_no_channels(campaign) == ""
    (axes,) = figures_of(campaign)["channels"]().axes
    intervals = [bars.errorbar.lines[2][0].get_segments() for bars in axes.containers[1::2]]
    assert axes.get_xlim() == (0.0, 100.0)
    assert [len(segments) for segments in intervals] == [9, 9]
    for (low, _), (high, _) in itertools.chain(*intervals):
        assert 0.0 <= low < high <= 100.0
