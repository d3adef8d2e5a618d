"""Folders of runs: only what an earlier run wrote is removed."""

import os
import tempfile
import unittest

import paths  # noqa: F401
from folder import ForeignFile, RunFolder


class Folder(unittest.TestCase):
    def test_only_what_an_earlier_run_wrote_is_removed(self):
        with tempfile.TemporaryDirectory() as place:
            path = os.path.join(place, "run")

            def run():
                with RunFolder(path) as out:
                    os.mkdir(os.path.join(out.path, "logs"))
                    for name in ("report.html", os.path.join("logs", "node.log")):
                        with open(os.path.join(out.path, name), "x", encoding="utf-8") as file:
                            file.write("text")

            run()
            run()
            with open(os.path.join(path, "notes.txt"), "w", encoding="utf-8") as file:
                file.write("mine")
            with self.assertRaises(ForeignFile):
                run()
            self.assertTrue(os.path.exists(os.path.join(path, "report.html")))
            os.remove(os.path.join(path, "notes.txt"))
            with open(os.path.join(path, "report.html"), "a", encoding="utf-8") as file:
                file.write("changed")
            with self.assertRaises(ForeignFile):
                run()


if __name__ == "__main__":
    unittest.main()
