"""The one door to Dask: an existing cluster behind the same futures as the local pool."""

import contextlib
import logging
from concurrent.futures import Future
from typing import Any

from emran_sumo.errors import UserError
from emran_sumo.study import identity
from emran_sumo.study.worker import Outcome, Task, drive_task

PATIENCE = 10.0  # s to reach the scheduler and its first worker


class ClusterPool:
    """Workers of the Dask cluster at `address`.

    Raises:
        UserError: the cluster does not answer, has no worker, or its workers run another version.
    """

    def __init__(self, address: str) -> None:
        try:
            import distributed
            from distributed.scheduler import KilledWorker
        except ImportError:
            raise UserError('--dask: needs the extra "cluster": pip install "emran-sumo[cluster]".') from None
        # a task that ends its worker is tried elsewhere by the scheduler before it is given up
        self.died: tuple[type[BaseException], ...] = (KilledWorker,)
        quiet = logging.getLogger("distributed")
        quiet.setLevel(logging.CRITICAL)
        scheme, _, place = address.rpartition("://")
        host, _, port = place.rpartition(":")
        if scheme not in ("", "tcp", "tls", "ws", "wss", "ucx") or not host or not port.isdecimal():
            raise UserError(f'--dask: found "{address}"; accepted is the address of a scheduler, e.g. tcp://host:8786.')
        try:
            self._client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            said = str(error).partition("\n")[0].rstrip(".")
            raise UserError(f"--dask: found {address}; no cluster answers there: {said}.") from None
        self._executor = self._client.get_executor(pure=False, retries=0)
        try:
            self._client.wait_for_workers(1, timeout=PATIENCE)
            theirs = self._client.submit(identity.installed, pure=False).result(timeout=6 * PATIENCE)
        except (OSError, TimeoutError) as error:
            self.close()
            raise UserError(f"--dask: the cluster at {address} has no worker that answers: {error}.") from None
        except Exception as error:
            self.close()
            raise UserError(f"--dask: the workers of {address} cannot run emran_sumo: {error}.") from None
        differ = identity.differences(theirs, identity.installed())
        if differ:
            self.close()
            raise UserError(f"--dask: the workers of {address} differ from this machine: {'; '.join(differ)}.")

    @property
    def room(self) -> int:
        """How many runs may be under way: one for each worker, one waiting behind it."""
        workers: Any = self._client.nthreads()
        return 2 * max(len(workers), 1)

    def submit(self, task: Task) -> "Future[Outcome]":
        """Hand a run to the scheduler."""
        return self._executor.submit(drive_task, task)

    def settle(self, future: "Future[Outcome]") -> None:
        """Nothing is to be taken back: the scheduler looks after its workers."""

    def close(self) -> None:
        """Leave the cluster; it lives on."""
        with contextlib.suppress(Exception):
            self._executor.shutdown(wait=False)
        with contextlib.suppress(Exception):
            self._client.close(timeout=PATIENCE)
