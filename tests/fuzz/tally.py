"""Fuzzes every reader and prints the table.

python tests/fuzz/tally.py --inputs 20000 --seed 7 [--keep FOLDER]
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from test_fuzz import INPUTS, fuzz


def main():
    """Share the inputs among the targets, in parts, and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", default="7")
    parser.add_argument("--keep", default=None)
    parser.add_argument("--only", nargs="*", default=sorted(INPUTS))
    given = parser.parse_args()
    share = sum(INPUTS[name] for name in given.only)
    print("target          inputs  accepted  refused  findings      s    GB")
    total, findings = 0, []
    for name in given.only:
        count = -(-given.inputs * INPUTS[name] // share)
        keep = () if given.keep is None else ("--keep", given.keep)
        told = fuzz(name, "--inputs", str(count), "--seed", given.seed, *keep)
        print(
            f"{name:14} {told['inputs']:7} {told['accepted']:9} {told['refused']:8} "
            f"{len(told['findings']):9} {told['seconds']:6.1f} {told['gigabytes']:5.2f}",
            flush=True,
        )
        total += told["inputs"]
        findings += [(name, finding) for finding in told["findings"]]
    print(f"{total} inputs, {len(findings)} findings")
    for name, finding in findings:
        print(f"  {name} {finding['number']}: {finding['what'][:300]}")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
