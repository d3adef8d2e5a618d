"""The streams that the simulation waits for."""

import unittest

import paths  # noqa: F401

try:
    from stream import Stream
except ImportError as error:
    raise unittest.SkipTest(f"{error}: test/loop/setup FOLDER makes an environment") from error


def in_pace(count):
    """A stream of 100 Hz whose messages came in time."""
    stream = Stream()
    for k in range(count):
        stream.expect(k / 100 + 0.01, k / 100)
        stream.note(k / 100)
    return stream


class Waiting(unittest.TestCase):
    def test_only_a_stream_that_kept_pace_is_waited_for(self):
        for count, expected in ((Stream.STREAK - 1, False), (Stream.STREAK, True)):
            stream = in_pace(count)
            stream.expect(1.0, 0.99)
            self.assertFalse(stream.late(0.995))
            self.assertEqual(stream.late(1.0), expected)

    def test_a_message_that_came_before_it_was_expected_counts(self):
        stream = in_pace(Stream.STREAK)
        stream.note(0.99)
        stream.expect(1.0, 0.99)
        self.assertFalse(stream.late(1.0))
        self.assertEqual(stream.streak, Stream.STREAK + 1)

    def test_one_miss_is_forgiven_and_two_are_an_outage(self):
        stream = in_pace(Stream.STREAK)
        stream.expect(1.0, 0.99)
        stream.miss(1.0)
        stream.expect(1.01, 1.0)
        stream.note(1.0)
        stream.expect(1.02, 1.01)
        self.assertTrue(stream.late(1.02))
        stream.miss(1.02)
        stream.expect(1.03, 1.02)
        self.assertFalse(stream.late(1.03))


if __name__ == "__main__":
    unittest.main()
