# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Workers, here or on a Dask cluster: fed with chunks, they give results as they come."""

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import TypeVar

from gtmr_codegen.library import CompileError
from gtmr_sim.loop.memory import library
from gtmr_study.campaign.study import Study
from gtmr_study.campaign.trial import ERROR, Row, empty_row, fly_trials
from gtmr_study.own_controller import OwnController
from gtmr_study.result_files import InputError, one_line

CONNECT_TIMEOUT_S = 3.0
"""How long a scheduler may take to answer [s]."""
WORKERS_TIMEOUT_S = 3.0
"""How long a scheduler may be without workers at the start [s]."""
CHUNK_FLIGHT_S = 100.0
"""Simulated flight handed out at a time: long against the cost of handing out, short enough that
a worker's death costs little [s]."""
LARGEST_CHUNK = 64
"""Flights in a chunk at most."""

LOOPBACK = "127.0.0.1"
"""Where scheduler, workers and dashboard on this machine listen, and nowhere else."""

Flights = Sequence[tuple[int, str]]
Chunk = TypeVar("Chunk")
Plan = TypeVar("Plan")
Result = TypeVar("Result")


@contextmanager
def local_threads(count: int | None = None) -> Iterator[Executor]:
    """Start threads, one per processor if it is not said how many: for flights that run in C.

    Where nothing can be compiled they are processes.
    """
    try:
        library()
    except CompileError:
        with local_workers(count) as workers:
            yield workers
        return
    pool = ThreadPoolExecutor(_processors(count))
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def local_workers(count: int | None = None) -> Iterator[Executor]:
    """Start Dask's processes on this machine, as many as `local_threads`: for work in Python."""
    # Only here, as it takes long to import.
    from distributed import Client, LocalCluster

    _be_quiet()
    n = _processors(count)
    with _deaf_to_interrupts():
        cluster = LocalCluster(
            n_workers=n,
            threads_per_worker=1,
            host=LOOPBACK,
            # Any free port: several campaigns may run on one machine.
            dashboard_address=f"{LOOPBACK}:0",
            memory_limit=None,
            silence_logs=logging.CRITICAL,
        )
    with cluster, Client(cluster) as client:
        yield client.get_executor(pure=False)


def _processors(count: int | None) -> int:
    return count if count is not None else len(os.sched_getaffinity(0))


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Let processes that are started meanwhile leave Ctrl-C to this one, which ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def remote_workers(scheduler: str) -> Iterator[Executor]:
    """Connect to a running Dask scheduler; InputError if it does not answer or has no workers."""
    import dask
    from distributed import Client

    _be_quiet()
    try:
        with dask.config.set({"distributed.comm.timeouts.connect": CONNECT_TIMEOUT_S}):
            client = Client(scheduler, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(
            f"--scheduler = {scheduler}: no Dask scheduler answers: {reason}"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_TIMEOUT_S)
        except TimeoutError:
            raise InputError(
                f"--scheduler = {scheduler}: has no workers: start some with "
                f"dask worker {scheduler}"
            ) from None
        yield client.get_executor(pure=False)


def workers(
    count: int | None = None, scheduler: str | None = None
) -> AbstractContextManager[Executor]:
    """Start threads on this machine, or connect to a scheduler's workers, given by its address."""
    return local_threads(count) if scheduler is None else remote_workers(scheduler)


def fly_on(
    executor: Executor, study: Study, flights: Flights, own: OwnController | None = None
) -> Iterator[list[Row]]:
    """Fly on workers, in chunks; give the rows of each as it is done.

    A worker that dies has its chunks flown again elsewhere.
    """
    chunks = list(chunked(flights, study.duration_s))
    for chunk, rows in run_chunks(executor, partial(fly_trials, own=own), study, chunks):
        if isinstance(rows, BaseException):
            # Flights report their own errors; here the workers themselves gave up.
            lost = {"status": ERROR, "error": one_line(rows)}
            yield [empty_row(trial, mode) | lost for trial, mode in chunk]
        else:
            yield rows


def run_chunks(
    executor: Executor,
    function: Callable[[Plan, Chunk], Result],
    plan: Plan,
    chunks: Sequence[Chunk],
) -> Iterator[tuple[Chunk, Result | BaseException]]:
    """Run a function of a plan, as a study is, and a chunk on workers.

    Gives each chunk and its result, or what was raised, in the order in which they are done.
    """
    chunk_of = {executor.submit(function, plan, chunk): chunk for chunk in chunks}
    for future in as_completed(chunk_of):
        error = future.exception()
        # Results are held no longer than until they are handed on.
        yield chunk_of.pop(future), future.result() if error is None else error


def chunked(flights: Flights, duration_s: float) -> Iterator[Flights]:
    """Cut a campaign into the pieces that are handed out."""
    size = chunk_size(duration_s)
    return (flights[start : start + size] for start in range(0, len(flights), size))


def chunk_size(duration_s: float) -> int:
    """How many flights of a length [s] are handed out at a time."""
    return min(max(1, round(CHUNK_FLIGHT_S / duration_s)), LARGEST_CHUNK)


def _be_quiet() -> None:
    # Lost workers are replaced, and what matters of a lost scheduler is in our own message.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
