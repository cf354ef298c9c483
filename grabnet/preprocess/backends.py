"""Doing one piece of work after another in many processes, of this machine or of a cluster; some of which may die."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

from joblib import Parallel, delayed

from grabnet.errors import UserError

# Seconds to find a scheduler in.
_PATIENCE = 20


@dataclass(frozen=True)
class Outcome:
    """How the work on a recording ended.

    failure: why there are no frames of it, in a sentence. worker: host and process. peak_bytes: of that process so far.
    """

    name: str
    failure: str | None
    worker: str = ""
    peak_bytes: int = 0


Work = Callable[[str], Outcome]


def machine_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def by_joblib(work: Work, names: Sequence[str], workers: int, max_deaths: int) -> Iterator[Outcome]:
    """Do the work for each name in processes of this machine; outcomes as they come.

    When a process dies, what was not done goes on in new ones. Which of the names is to blame is not known where
    several are worked on at once: after a second death they are worked on one by one, and whichever has killed
    `max_deaths` processes alone has failed.
    """
    if workers == 1:
        yield from map(work, names)
        return
    left, deaths = dict.fromkeys(names, 0), 0
    while left:
        alone = deaths > 1
        parallel = Parallel(
            workers, return_as="generator_unordered", batch_size=1, pre_dispatch=1 if alone else "2*n_jobs"
        )
        try:
            for outcome in parallel(delayed(work)(name) for name in list(left)):
                del left[outcome.name]
                yield outcome
        except BrokenProcessPool:
            deaths += 1
            if alone:
                name = next(iter(left))
                left[name] += 1
                if left[name] == max_deaths:
                    del left[name]
                    yield Outcome(name, _killed(max_deaths))


def by_dask(work: Work, names: Sequence[str], address: str) -> Iterator[Outcome]:
    """Do the work for each name on the cluster of the scheduler at an address; outcomes as they come.

    What a worker had when it died goes to another one, until more workers have died of it than the scheduler's
    `allowed-failures`, 3 unless configured otherwise. As dask blames all that a worker had, it gets as many lives once
    more, alone on the cluster.

    Raises:
        UserError: dask is not installed; no scheduler answers, or it is lost.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
        from distributed.client import FutureCancelledError
    except ImportError:
        raise UserError("backend=dask needs dask: pip install -e '.[cluster]'.") from None
    try:
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise UserError(
            f"No dask scheduler answers at dask_address={address} ({error}): start one, or name it."
        ) from None
    try:
        with client:
            name_of = {client.submit(work, name, pure=False): name for name in names}
            blamed = []
            for future in as_completed(name_of, loop=client.loop):
                if isinstance(future.exception(), KilledWorker):
                    blamed.append(name_of[future])
                else:
                    yield future.result()
                future.release()
            for name in blamed:
                try:
                    yield client.submit(work, name, pure=False).result()
                except KilledWorker:
                    yield Outcome(name, _killed())
    except FutureCancelledError:
        raise UserError(
            f"The dask scheduler at dask_address={address} was lost: start both again; what is done stays."
        ) from None


def _killed(times: int | None = None) -> str:
    often = f"{times} times" if times else "again and again"
    return f"The process that worked on it died {often}, perhaps for want of memory."
