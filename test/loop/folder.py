"""Folder of a run, by the rules of docs/src/commands.md: `.volant-run` lists what the run wrote,
with sizes and times; the next run removes what is listed and unchanged, and nothing else."""

import os

LIST = ".volant-run"


class ForeignFile(Exception):
    """The folder holds something that no earlier run wrote."""


def entry(folder, path):
    """Size, time of change and relative name of a file."""
    there = os.lstat(path)
    seconds, nanoseconds = divmod(there.st_mtime_ns, 10**9)
    return f"{there.st_size} {seconds}.{nanoseconds:09} {os.path.relpath(path, folder)}"


def files_of(folder):
    """All files below a folder without the list; links are files."""
    found = []
    for place, folders, names in os.walk(folder):
        names = names + [name for name in folders if os.path.islink(os.path.join(place, name))]
        found += [os.path.join(place, name) for name in names]
    return [path for path in found if path != os.path.join(folder, LIST)]


class RunFolder:
    """An empty folder for a run; leaving the context writes its list."""

    def __init__(self, path):
        self.path = path = os.path.abspath(path)
        os.makedirs(path, exist_ok=True)
        listed = set()
        if os.path.isfile(os.path.join(path, LIST)):
            with open(os.path.join(path, LIST), encoding="utf-8") as file:
                listed = set(file.read().splitlines())
        files = files_of(path)
        for name in files:
            if entry(path, name) not in listed:
                raise ForeignFile(
                    f"{name}: it is not from an earlier run, or was changed since; nothing is "
                    "removed: give --out an empty or new folder")
        for name in files:
            os.remove(name)
        for place, _, _ in os.walk(path, topdown=False):
            if place != path:
                os.rmdir(place)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        with open(os.path.join(self.path, LIST), "w", encoding="utf-8") as file:
            file.writelines(entry(self.path, name) + "\n" for name in files_of(self.path))
