"""A stream of messages that the simulation waits for."""

from collections import deque

import numpy as np


class Stream:
    """A stream that the simulation waits for while it keeps pace: stamps that are due."""

    STREAK = 5  # messages in time before a stream counts as alive

    def __init__(self):
        self.due = deque()  # (time by which it is due, stamp)
        self.newest = -np.inf
        self.streak = 0

    def expect(self, by, stamp):
        """Adds a message that is due by a time."""
        self.due.append((by, stamp))

    def note(self, stamp):
        """Notes a received stamp."""
        self.newest = max(self.newest, stamp)
        self.settle()

    def settle(self):
        """Removes what has come; it may have come before it was expected."""
        while self.due and self.due[0][1] <= self.newest + 1e-3:
            self.due.popleft()
            self.streak += 1

    def late(self, now):
        """Whether to wait for a message. One that is missing without ends the streak."""
        self.settle()
        if not self.due or self.due[0][0] > now:
            return False
        if self.streak >= self.STREAK:
            return True
        self.give_up(now)
        return False

    def miss(self, now):
        """A message did not come: the next one in time counts again, a second miss is an outage."""
        self.give_up(now)
        self.streak = self.STREAK - 1

    def give_up(self, now):
        """The stream is interrupted: it is not waited for until it keeps pace again."""
        self.streak = 0
        while self.due and self.due[0][0] <= now:
            self.due.popleft()
