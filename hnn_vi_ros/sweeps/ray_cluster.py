# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Make shards on a Ray cluster: one actor per core; this process writes the files."""

from collections.abc import Iterator, Sequence
import logging

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.files import one_line
from hnn_vi_ros.sweeps.folder import SweepFolder
from hnn_vi_ros.sweeps.workers import ShardJob
import ray
from ray.exceptions import RayError
from ray.util import ActorPool

# Number of retries of a shard whose actor died with its process or its machine.
_RETRIES = 3


def make_on_ray(job: ShardJob, folder: SweepFolder, shards: Sequence[int], address: str
                ) -> Iterator[int]:
    """
    Make shards on a cluster, and yield the number of each one written to the folder.

    Parameters
    ----------
    job : ShardJob
        Job of the sweep.
    folder : SweepFolder
        Folder written by this process only; the workers do not need access to it.
    shards : sequence of int
        Numbers of the shards.
    address : str
        Address of the cluster; ``'auto'`` for the one this machine belongs to, ``'local'`` for a
        new one on this machine. If the process is already connected to Ray, that cluster is used.

    Raises
    ------
    HnnViRosError
        The cluster is missing, a shard cannot be made, or its workers are lost repeatedly.

    """
    own = not ray.is_initialized()
    if own:
        try:
            ray.init(address, log_to_driver=False, logging_level=logging.WARNING)
        except (ConnectionError, ValueError, RuntimeError) as problem:
            raise HnnViRosError(
                f'--ray {address}: {one_line(problem)}; start a cluster with: ray start --head, '
                'or use --ray local; a cluster at an address that requires a token needs '
                'RAY_AUTH_MODE=token') from problem
    try:
        yield from _distribute(job, folder, shards, address)
    except RayError as problem:
        raise HnnViRosError(f'--ray {address}: {one_line(problem)}; complete shards are kept: run '
                            'the same command again') from problem
    finally:
        if own:
            ray.shutdown()


def _distribute(job: ShardJob, folder: SweepFolder, shards: Sequence[int], address: str
                ) -> Iterator[int]:
    on_gpu = job.device is not None and job.device.startswith('cuda')
    there = ray.cluster_resources()
    makers = int(there.get('GPU', 0) if on_gpu else there.get('CPU', 1))
    if makers == 0:
        raise HnnViRosError(f'--ray {address} --device {job.device}: the cluster has no GPU; '
                            'remove --device, or start it with ray start --num-gpus N')
    actor = ray.remote(num_cpus=1, num_gpus=int(on_gpu), max_restarts=-1,
                       max_task_retries=_RETRIES)(ShardJob)
    # Two tasks per actor: while one shard is being made, the next one is already queued.
    pool = ActorPool([actor.remote(**vars(job)) for _ in range(min(makers, len(shards)))] * 2)
    for shard, content in pool.map_unordered(
            lambda maker, shard: maker.make.remote(shard), list(shards)):
        folder.put(shard, content)
        yield shard
