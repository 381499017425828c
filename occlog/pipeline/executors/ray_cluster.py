"""The workers of a Ray cluster, or of a Ray that is started on this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from occlog import __version__
from occlog.errors import UsageError

from .interface import Lost, R, T, done_alike
from .processes import ONE_THREAD, SAFE_PATH


class RayCluster:
    """Workers of Ray, each a process with one thread."""

    def __init__(self, address: str) -> None:
        """Use the cluster at an address, e.g. ray://10.0.0.1:10001; `ray` starts one on this machine."""
        self._address = address

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Iterate over the results; `Lost` for a piece whose worker died as often as Ray allows."""
        try:
            import ray
        except ImportError as error:
            raise UsageError("Ray is not installed; install occlog[ray], or use processes of this machine") from error
        library: Any = ray
        try:
            library.init(
                address=None if self._address == "ray" else self._address,
                runtime_env={"env_vars": dict.fromkeys(ONE_THREAD, "1") | SAFE_PATH},
                log_to_driver=False,
                include_dashboard=False if self._address == "ray" else None,
            )
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            raise UsageError(f"scheduler {self._address}: does not answer ({error}); start it") from error
        try:
            # It takes functions alone, not those with some arguments bound
            remote = library.remote(num_cpus=1)(done_alike)
            running = {remote.remote(__version__, work, piece): key for key, piece in todo.items()}
            while running:
                (done, *_), _ = library.wait(list(running))
                try:
                    result = library.get(done)
                except (library.exceptions.WorkerCrashedError, library.exceptions.OutOfMemoryError) as error:
                    result = Lost(f"its worker died ({type(error).__name__})")
                yield running.pop(done), result
        finally:
            library.shutdown()
