"""Does the jobs of a table, a shell command a line, on a Dask cluster.

Usage: with_dask.py JOBS [ADDRESS]

Without the address of a scheduler, on two workers of this machine.
"""

import subprocess
import sys
from pathlib import Path

from distributed import Client, LocalCluster, as_completed


def run(job):
    done = subprocess.run(job, shell=True, capture_output=True, text=True)
    return job, done.returncode, done.stderr


def main(table, address=None):
    jobs = [line for line in Path(table).read_text().splitlines() if line.strip()]
    cluster = address or LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    failed = 0
    with Client(cluster) as client:
        # A job that was lost with its worker is done again: its output is whole or absent.
        futures = client.map(run, jobs, pure=False, retries=2)
        for count, future in enumerate(as_completed(futures), 1):
            job, code, complaint = future.result()
            print(f"{count} of {len(jobs)}", flush=True)
            if code != 0:
                failed += 1
                print(f"{job}: exit code {code}\n{complaint}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    if not 2 <= len(sys.argv) <= 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
