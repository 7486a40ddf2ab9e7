# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The report of a campaign says what its files say, in one file that needs nothing else."""

import itertools
import json
import re
import shutil
from pathlib import Path

import pandas as pd
import pytest
from support.pages import needs_chromium, opened, require_for_everybody, wait_until_drawn

from gtmr_study.campaign.figures import (
    Campaign,
    figures_of,
    why_no_channels,
    write_figures,
)
from gtmr_study.campaign.report.page import write_campaign_report
from gtmr_study.campaign.trials_file import read_trials
from gtmr_study.result_files import InputError

pytestmark = pytest.mark.slow

COMMITTED = Path(__file__).parents[2] / "docs" / "reproduction" / "default"


@needs_chromium
def test_everybody_can_read_the_report_on_every_screen_in_both_themes(tmp_path, axe):
    all_of_it = part_of_committed(tmp_path / "all", 500)
    html, *_ = write_campaign_report([all_of_it], tmp_path / "report.html")

    with opened(html) as page:
        wait_until_drawn(page)
        shares = "document.getElementById('campaign-3').layout.xaxis.range.join()"
        assert page.evaluate(shares) == "0,100"
        require_for_everybody(page, axe)


def test_few_trials_are_told_how_many_more_they_would_need(flown, tmp_path):
    html, *_ = write_campaign_report([flown], tmp_path / "report.html")

    text = html.read_text(encoding="utf-8")
    assert "cannot be told from 6 trials" in text
    assert "Shares of variance" not in text


def test_the_command_of_each_worst_trial_gives_its_least_clearance(flown, tmp_path, gtmr):
    html, *_ = write_campaign_report([flown], tmp_path / "again.html")
    rows = read_trials(flown)

    commands = re.findall(r">gtmr (fly --scenario \S+?)</code>", html.read_text(encoding="utf-8"))

    assert len(commands) == 10
    for command in commands:
        told = tmp_path / "told.json"
        *rest, scenario = command.split()
        mode, trial = Path(scenario).stem.split("-")
        ended = gtmr(*rest, html.parent / scenario, "--json", told)
        assert ended.returncode == 0, ended.stderr
        row = rows[(rows["mode"] == mode) & (rows["trial"] == int(trial))].iloc[0]
        again = json.loads(told.read_text())
        assert again["min_clearance_m"] == pytest.approx(row["min_clearance_m"], abs=1e-6)
        assert again["mode"] == mode
    worst = rows[rows["mode"] == "robust"]["min_clearance_m"].nsmallest(5)
    listed = [int(re.search(r"robust-(\d+)", c)[1]) for c in commands if "robust" in c]
    assert listed == rows.loc[worst.index, "trial"].tolist()


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
