"""Dask: workers on this machine or on a cluster, fed with chunks, results as they come."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import dask
from distributed import Client, LocalCluster, as_completed

from gtmr_nmpc import Mode
from gtmr_study.result_files import InputError
from gtmr_study.study import Study
from gtmr_study.trial import ERROR, Row, empty_row, fly_trials

CONNECT_TIMEOUT_S = 4.0
"""How long a scheduler may take to answer [s]."""
WORKERS_TIMEOUT_S = 4.0
"""How long a scheduler may be without workers at the start [s]."""
CHUNK_FLIGHT_S = 100.0
"""Simulated flight handed out at a time: long against the cost of handing out, short enough that
a worker's death costs little [s]."""
LARGEST_CHUNK = 64
"""Flights in a chunk at most."""

Flights = Sequence[tuple[int, Mode]]


@contextmanager
def workers(count: int | None = None, scheduler: str | None = None) -> Iterator[Client]:
    """Connect to Dask workers.

    Parameters
    ----------
    count : int, optional
        Processes to start on this machine; one per processor if left out.
    scheduler : str, optional
        Address of a running scheduler, instead.

    Yields
    ------
    distributed.Client

    Raises
    ------
    InputError
        If the scheduler does not answer, or has no workers.
    """
    # Dask's own account of a lost connection adds nothing to ours; lost workers are replaced.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if scheduler is not None:
        with _connected(scheduler) as client:
            yield client
        return
    n = count if count is not None else len(os.sched_getaffinity(0))
    with (
        LocalCluster(
            n_workers=n,
            threads_per_worker=1,
            dashboard_address=None,
            memory_limit=None,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def fly_on(client: Client, study: Study, flights: Flights) -> Iterator[list[Row]]:
    """Fly on workers, in chunks.

    Parameters
    ----------
    client : distributed.Client
        The workers; one that dies has its chunks flown again elsewhere.
    study : Study
        The campaign.
    flights : sequence of (int, str)
        Numbers of trials, and modes.

    Yields
    ------
    list of dict
        The rows of one chunk, in the order in which chunks are done.
    """
    chunks = list(chunked(flights, study.duration_s))
    futures = client.map(lambda chunk: fly_trials(study, chunk), chunks, pure=False)
    of = {future.key: chunk for future, chunk in zip(futures, chunks, strict=True)}
    done = as_completed(futures)
    del futures
    for future in done:
        if future.status == "finished":
            yield future.result()
        else:
            # Flights report their own errors; here the workers themselves gave up.
            yield [_lost(trial, mode, future.exception()) for trial, mode in of[future.key]]
        future.release()


def chunked(flights: Flights, duration_s: float) -> Iterable[Flights]:
    """Cut a campaign into the pieces that are handed out.

    Parameters
    ----------
    flights : sequence of (int, str)
        Numbers of trials, and modes.
    duration_s : float
        Length of each [s].

    Returns
    -------
    iterable of sequence of (int, str)
    """
    size = min(max(1, round(CHUNK_FLIGHT_S / duration_s)), LARGEST_CHUNK)
    return (flights[start : start + size] for start in range(0, len(flights), size))


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    try:
        with dask.config.set({"distributed.comm.timeouts.connect": CONNECT_TIMEOUT_S}):
            client = Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError, TimeoutError) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(f"--scheduler = {address}: no Dask scheduler answers: {reason}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_TIMEOUT_S)
        except TimeoutError:
            raise InputError(
                f"--scheduler = {address}: has no workers: start some with dask worker {address}"
            ) from None
        yield client


def _lost(trial: int, mode: Mode, error: Any) -> Row:
    reason = " ".join(f"{type(error).__name__}: {error}".split())
    return empty_row(trial, mode) | {"status": ERROR, "error": reason}
