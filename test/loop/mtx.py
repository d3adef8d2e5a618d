"""The device side of an Xsens MTx on a pseudo-terminal, in simulated time.

Written from the vendor's protocol manual (MT0101P). Frames are `FA BID MID LEN data CS`; the sum
of all bytes after FA is 0 modulo 256. [`Mtx`] is the pure device: bytes from the host in, frames
with the time of their last bit out. [`Port`] is the pseudo-terminal behind a symbolic link, which
unplugging removes.
"""

import fcntl
import os
import struct
import tty

import numpy as np

BAUD = 115_200
TCGETS2, TERMIOS2 = 0x802C542A, struct.Struct("4I20B2I")  # Linux; the last two are the speeds
BYTE_TIME = 10 / BAUD  # 8N1, s
TICKS = 115_200.0  # of the sampling period, 1/s
PREAMBLE, MASTER = 0xFA, 0xFF

WAKE_UP_ACK, GO_TO_CONFIG, GO_TO_MEASUREMENT, RESET = 0x3F, 0x30, 0x10, 0x40
REQ_DEVICE_ID, REQ_PRODUCT_CODE, REQ_FIRMWARE, REQ_HARDWARE = 0x00, 0x1C, 0x12, 0x1E
REQ_CONFIGURATION, REQ_DATA_LENGTH, PERIOD, SKIP_FACTOR = 0x0C, 0x0A, 0x04, 0xD4
OUTPUT_MODE, OUTPUT_SETTINGS, MT_DATA, ERROR = 0xD0, 0xD2, 0x32, 0x42

MODE_TEMPERATURE, MODE_CALIBRATED, MODE_ORIENTATION = 0x0001, 0x0002, 0x0004
SETTINGS_COUNTER, SETTINGS_NO_MAGNETIC = 0x1, 0x40

PERIOD_INVALID, MESSAGE_INVALID, PARAMETER_INVALID = 0x03, 0x04, 0x21
CONFIG_DELAY = 0.1  # until GoToConfig is acknowledged, s (manual: 0.1 to 0.2)
ACK_DELAY = 0.002  # of other messages, s

# Half a turn about up and a quarter back: x east, y north → x north, y west.
NWU_FROM_ENU = np.array([np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)])


def frame(message, data=b"", bus=MASTER):
    """One message with preamble, length and checksum."""
    body = bytes([bus, message, len(data)]) + data
    return bytes([PREAMBLE]) + body + bytes([-sum(body) & 0xFF])


def parse(buffer):
    """Splits received bytes into messages (bus, message, data) and the incomplete rest.

    After a bad frame the search goes on one byte later.
    """
    messages, at = [], 0
    while True:
        at = buffer.find(PREAMBLE, at)
        if at < 0:
            return messages, b""
        if len(buffer) < at + 5 or len(buffer) < at + 5 + buffer[at + 3]:
            return messages, buffer[at:]
        end = at + 5 + buffer[at + 3]
        if sum(buffer[at + 1 : end]) & 0xFF == 0:
            messages.append((buffer[at + 1], buffer[at + 2], buffer[at + 4 : end - 1]))
            at = end
        else:
            at += 1


def quaternion_product(a, b):
    """Hamilton product, w first."""
    w, v = a[0], a[1:]
    return np.array([w * b[0] - v @ b[1:], *(w * b[1:] + b[0] * v + np.cross(v, b[1:]))])


class Mtx:
    """An MTx with factory settings: 100 Hz, calibrated data and quaternion, no sample counter.

    `sample(t)` returns specific force (m/s²), angular velocity (rad/s), both in the sensor's axes
    and with its errors, and the quaternion (w first) from the sensor to east-north-up.
    """

    def __init__(self, sample):
        self.sample = sample
        self.period, self.skip = 1152, 0
        self.mode, self.settings = MODE_CALIBRATED | MODE_ORIENTATION, 0
        self.counter = 0
        self.measuring_since = 0.0  # None in the config state
        self.samples = 0  # since then
        self.config_at = None
        self.free = 0.0  # when the line is free, s
        self.pending = b""

    def data_length(self):
        """Length of the data of MTData, bytes."""
        vectors = 2 if self.settings & SETTINGS_NO_MAGNETIC else 3
        return (
            4 * bool(self.mode & MODE_TEMPERATURE)
            + 12 * vectors * bool(self.mode & MODE_CALIBRATED)
            + 16 * bool(self.mode & MODE_ORIENTATION)
            + 2 * bool(self.settings & SETTINGS_COUNTER)
        )

    def interval(self):
        """Time between two messages, s."""
        return self.period * (self.skip + 1) / TICKS

    def handle(self, data, now):
        """Takes bytes from the host; returns the replies as (time of the last bit, bytes)."""
        messages, self.pending = parse(self.pending + data)
        return [reply for bus, mid, body in messages for reply in self.answer(bus, mid, body, now)]

    def answer(self, bus, mid, data, now):
        """Replies to one message."""
        if mid == GO_TO_CONFIG:
            self.config_at = now + CONFIG_DELAY
            return [self.send(frame(mid + 1, bus=bus), self.config_at)]
        if self.measuring_since is not None:
            return []  # other requests are ignored while measuring
        try:
            reply = self.configure(mid, data, now)
        except ValueError as error:
            return [self.send(frame(ERROR, bytes([error.args[0]]), bus), now + ACK_DELAY)]
        return [self.send(frame(mid + 1, reply, bus), now + ACK_DELAY)]

    def configure(self, mid, data, now):
        """Data of the acknowledgement in the config state; raises the code of an error."""
        if mid == REQ_DEVICE_ID:
            return struct.pack(">I", 0x0030_0C7B)
        if mid == REQ_PRODUCT_CODE:
            return b"MTx-28A53G25".ljust(20)
        if mid == REQ_FIRMWARE:
            return bytes([2, 6, 0])
        if mid == REQ_HARDWARE:
            return bytes([1, 0])
        if mid == REQ_DATA_LENGTH:
            return struct.pack(">H", self.data_length())
        if mid == REQ_CONFIGURATION:
            return self.configuration()
        if mid == GO_TO_MEASUREMENT:
            # Samples begin with a cycle of the simulation, so that its lock-step is simple.
            self.measuring_since = np.ceil((now + ACK_DELAY + 0.005) * 100.0) / 100.0
            self.samples = 0
            return b""
        for setting, name, code in (
            (PERIOD, "period", ">H"), (SKIP_FACTOR, "skip", ">H"),
            (OUTPUT_MODE, "mode", ">H"), (OUTPUT_SETTINGS, "settings", ">I"),
        ):
            if mid == setting:
                if not data:
                    return struct.pack(code, getattr(self, name))
                if len(data) != struct.calcsize(code):
                    raise ValueError(PARAMETER_INVALID)
                value = struct.unpack(code, data)[0]
                if name == "period" and not 225 <= value <= 11_520:
                    raise ValueError(PERIOD_INVALID)
                setattr(self, name, value)
                return b""
        raise ValueError(MESSAGE_INVALID)

    def configuration(self):
        """The 118 bytes of the Configuration message."""
        data = bytearray(118)
        struct.pack_into(">IHH", data, 0, 0x0030_0C7B, self.period, self.skip)
        struct.pack_into(
            ">HIHHI", data, 96, 1, 0x0030_0C7B, self.data_length(), self.mode, self.settings
        )
        return bytes(data)

    def next_sample(self):
        """Time of the next sample, s; infinite in the config state."""
        if self.measuring_since is None:
            return np.inf
        return self.measuring_since + self.samples * self.interval()

    def advance(self, now):
        """Takes the samples due by `now`; returns (time of the last bit, bytes, time of it)."""
        sent = []
        while True:
            at = self.next_sample()
            if self.config_at is not None and self.config_at <= min(at, now):
                self.config_at, self.measuring_since = None, None
                return sent
            if at > now + 1e-9:
                return sent
            arrival, data = self.send(frame(MT_DATA, self.measure(at)), at)
            sent.append((arrival, data, at))
            self.samples += 1
            self.counter = (self.counter + 1) & 0xFFFF

    def measure(self, at):
        """Data of one MTData message."""
        force, rate, enu_from_sensor = self.sample(at)
        out = b""
        if self.mode & MODE_TEMPERATURE:
            out += struct.pack(">f", 25.0)
        if self.mode & MODE_CALIBRATED:
            out += struct.pack(">6f", *force, *rate)
            if not self.settings & SETTINGS_NO_MAGNETIC:
                out += struct.pack(">3f", 0.4, 0.0, -0.9)
        if self.mode & MODE_ORIENTATION:
            # The legacy global frame: x north, y west, z up.
            out += struct.pack(">4f", *quaternion_product(NWU_FROM_ENU, enu_from_sensor))
        if self.settings & SETTINGS_COUNTER:
            out += struct.pack(">H", self.counter)
        return out

    def send(self, data, at):
        """Queues a frame on the line; returns the time of its last bit and the bytes."""
        self.free = max(at, self.free) + len(data) * BYTE_TIME
        return self.free, data


class Port:
    """A pseudo-terminal that the driver opens through the symbolic link `link`."""

    def __init__(self, link):
        self.link = link
        self.master = self.slave = None
        self.plug()

    def plug(self):
        """Plugs the adapter in: a new pseudo-terminal."""
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        if os.path.islink(self.link):
            os.remove(self.link)
        os.symlink(os.ttyname(self.slave), self.link)

    def unplug(self):
        """Pulls the adapter: the port disappears."""
        if self.master is not None:
            os.remove(self.link)
            os.close(self.slave)
            os.close(self.master)
            self.master = self.slave = None

    def read(self):
        """Bytes from the host; none while it uses another baud rate."""
        if self.master is None:
            return b""
        try:
            data = os.read(self.master, 4096)
        except BlockingIOError:
            return b""
        return data if self.baud() == BAUD else b""

    def baud(self):
        """Baud rate that the host has set; termios does not know those beside the usual ones."""
        settings = fcntl.ioctl(self.master, TCGETS2, bytes(TERMIOS2.size))
        return TERMIOS2.unpack(settings)[-1]

    def write(self, data):
        """Bytes to the host; lost while its buffer is full."""
        if self.master is not None:
            try:
                os.write(self.master, data)
            except BlockingIOError:
                pass
