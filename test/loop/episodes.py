"""What happens in each episode. Times are s from the release of the platform."""

from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class Episode:
    """One run. Intervals are (begin, end), s."""

    name: str
    title: str
    seconds: float
    angle: float = 0.0  # swing at the release, degrees
    direction: float = -105.0  # toward which it is displaced, degrees from the world's x
    goals: tuple = ((0.0, 0.0, 0.12, 0.0),)  # (time, x, y, heading): m, rad
    payload: float = 0.0  # amplitude with which the payload moves, m
    push: tuple = ()  # (begin, end, force x, force y), N
    cover: tuple = ()  # all markers are covered
    unplug: tuple = ()  # the IMU's adapter is unplugged
    freeze: tuple = ()  # the camera repeats one image with new stamps
    outliers: tuple = ()  # every second encoder reading is off by 0.5 m
    cut: tuple = ()  # nothing passes between the climber's computer and the platform's
    controller: dict = field(default_factory=dict)  # parameters that differ

    def fault(self):
        """The interval of the fault; empty without one."""
        return self.cover or self.unplug or self.freeze or self.outliers or self.cut


# Each fault occurs while the platform drives and swings.
DRIVE = {
    "seconds": 10.0,
    "angle": 6.0,
    "goals": ((0.0, 0.0, 0.12, 0.0), (1.0, 0.5, -0.2, 0.0), (4.5, -0.3, 0.3, 0.2)),
}

EPISODES = [
    Episode("swing", "Swing damping from 15°", 10.0, angle=15.0),
    Episode(
        "waypoints", "Way-points with a moving payload", 24.0, payload=0.08,
        goals=((0.0, 0.7, 0.5, 0.0), (6.0, -0.6, 0.6, 0.4), (12.0, -0.5, -0.5, -0.3),
               (18.0, 0.0, 0.12, 0.0)),
    ),
    Episode("push", "Push of 3 N·s", 9.0, push=(1.0, 1.1, 18.0, 24.0)),
    Episode("covered", "Markers covered for 1 s", cover=(2.0, 3.0), **DRIVE),
    Episode("unplugged", "IMU unplugged for 1 s", unplug=(2.0, 3.0), **DRIVE),
    Episode("frozen", "Camera frozen for 1 s", freeze=(2.0, 3.0), **DRIVE),
    Episode("outliers", "Encoder outliers for 1 s", outliers=(2.0, 3.0), **DRIVE),
    Episode("cut", "Network cut of 0.5 s", cut=(2.0, 2.5), **DRIVE),
    Episode(
        "lost", "IMU unplugged and markers covered for 1.5 s", cover=(2.0, 3.5),
        unplug=(2.0, 3.5), **DRIVE,
    ),
]


def damping_episode(damping, predict):
    """Swing of 4° with this thruster damping (N s/m); the rails only hold their place."""
    limits = {"damping": float(damping), "use_prediction": predict, "swing_gain": 0.0}
    return Episode(
        f"gain_{damping:.0f}_{'predicted' if predict else 'present'}",
        f"Damping {damping:.0f} N s/m", 6.0, angle=4.0,
        controller=limits | {"force_limit": 8.0, "force_rate_limit": 1000.0},
    )


def by_name(name):
    """The episode of this name."""
    return next(episode for episode in EPISODES if episode.name == name)


def shortened(episode, seconds):
    """The first seconds of an episode, for tests."""
    return replace(episode, seconds=min(seconds, episode.seconds))
