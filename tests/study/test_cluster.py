# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Dask's processes on this machine can be reached from this machine alone."""

import os

from support.processes import descendants, is_open_to_the_network, open_addresses

from gtmr_study.campaign.cluster import local_workers


def test_scheduler_workers_and_dashboard_listen_on_loopback_alone():
    with local_workers(1) as client:
        client.submit(os.getpid).result()
        listening = {
            address
            for process_id in (os.getpid(), *descendants(os.getpid()))
            for _, address in open_addresses(process_id)
        }
        assert listening
        assert not set(filter(is_open_to_the_network, listening))
