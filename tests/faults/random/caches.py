"""What hits a run's caches: the compiled scenes, and the results of earlier runs."""

import shutil
from contextlib import suppress

from aftermath import other_results
from hits import begin, cache_of
from origins import VERDICT


def removed_cache(case, origin):
    begin(case, origin)
    case.wait_until(case.listens)
    case.sleep(1.0)
    shutil.rmtree(case.work / "cache" / "scenes", ignore_errors=True)


def corrupted_splats(case, origin):
    """Damage every compiled scene of the cache before a run maps it."""
    for file in _files(cache_of(case, origin) / "scenes"):
        _damage(file, case.draw)
    begin(case, origin)


def corrupted_entries(case, origin):
    """Damage rows and logs of earlier results before a run that would take them over."""
    share = case.draw.choice([0.2, 0.5, 1.0])
    for file in _files(cache_of(case, origin) / "trials"):
        if case.draw.random() < share:
            _damage(file, case.draw)
    begin(case, origin)


def entries_corrupted_in_mid_run(case, origin):
    """Damage results while a run takes some over and keeps others, and let another take the rest.

    The other is the one that is looked at in the end.
    """
    results = cache_of(case, origin) / "trials"
    for entry in sorted(results.glob("*/*")):
        if case.draw.random() < 0.5:
            shutil.rmtree(entry)
    begin(case, origin)
    while case.run.poll() is None:
        with suppress(OSError):  # What was there a moment ago need not be.
            _damage(case.draw.choice(_files(results)), case.draw)
        case.sleep(0.05)
    if case.run.end() != VERDICT:
        case.wrong.append(f"code {case.run.end()} while entries were damaged: {case.run.said}")
    case.wrong += other_results(case, origin)
    case.folder = case.work / "later"
    begin(case, origin)


def _files(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _damage(file, draw):
    """Change a bit of a file, or cut it short.

    It is another file from then on: nobody sees bits that flip in one that is mapped or linked.
    """
    data = bytearray(file.read_bytes())
    if not data:
        return
    if draw.random() < 0.5:
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    else:
        del data[draw.randrange(len(data)) :]
    file.unlink()
    file.write_bytes(data)
