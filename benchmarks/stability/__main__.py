"""Command line of the stability suite."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import benchmarks.stability as suite
from benchmarks.stability.table import collect, record, run, show


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stability",
        description=suite.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="rows whose name contains any WORD")
    parser.add_argument("--quick", action="store_true", help="leave out the slow rows")
    parser.add_argument("--list", action="store_true", help="name the rows and run none")
    parser.add_argument("--threads", type=int, default=1, help="torch threads (default 1)")
    parser.add_argument("--json", type=Path, help="also write the table to this file")
    options = parser.parse_args()

    import torch

    torch.set_num_threads(options.threads)
    rows = [
        row
        for row in collect()
        if (not options.only or any(word.lower() in row.name.lower() for word in options.only))
        and not (options.quick and row.slow)
    ]
    if not rows:
        parser.error(f"no row's name contains any of: {', '.join(options.only)}")
    if options.list:
        print("\n".join(row.name for row in rows))
        return 0
    outcomes = [run(row) for row in rows]
    print(show(outcomes))
    count = {
        verdict: sum(o.verdict == verdict for o in outcomes) for verdict in ("pass", "miss", "skipped", "elsewhere")
    }
    print(", ".join(f"{number} {verdict}" for verdict, number in count.items() if number))
    if options.json:
        options.json.write_text(json.dumps(record(outcomes), indent=1) + "\n", encoding="utf-8")
    return 1 if count["miss"] else 0


if __name__ == "__main__":
    sys.exit(main())
