"""Bytes of the simulated MTx: frames, handshake, data, the pseudo-terminal."""

import os
import struct
import tempfile
import unittest

import paths  # noqa: F401
import numpy as np
import mtx


def still(_):
    return [0.1, -0.2, 9.8], [0.01, 0.02, -0.03], np.array([1.0, 0.0, 0.0, 0.0])


def in_config_state():
    device = mtx.Mtx(still)
    device.handle(mtx.frame(mtx.GO_TO_CONFIG), 1.0)
    device.advance(1.2)
    return device


def ask(device, message, data=b"", now=2.0):
    """Reply to one request: (message, data)."""
    (_, reply), = device.handle(mtx.frame(message, data), now)
    (_, mid, body), = mtx.parse(reply)[0]
    return mid, body


class Frames(unittest.TestCase):
    def test_frames_of_the_manual(self):
        self.assertEqual(mtx.frame(mtx.GO_TO_CONFIG), bytes.fromhex("faff3000d1"))
        self.assertEqual(mtx.frame(0x31), bytes.fromhex("faff3100d0"))
        self.assertEqual(mtx.frame(mtx.GO_TO_MEASUREMENT), bytes.fromhex("faff1000f1"))

    def test_any_split_of_the_bytes_gives_the_same_messages(self):
        stream = b"\xfa\x00\x01\x02" + mtx.frame(0x0C) + b"\x42" + mtx.frame(0xD0, b"\x00\x06")
        whole, rest = mtx.parse(stream)
        self.assertEqual([(m, d) for _, m, d in whole], [(0x0C, b""), (0xD0, b"\x00\x06")])
        self.assertEqual(rest, b"")
        for cut in range(len(stream)):
            first, rest = mtx.parse(stream[:cut])
            second, _ = mtx.parse(rest + stream[cut:])
            self.assertEqual(first + second, whole, cut)


class Handshake(unittest.TestCase):
    def test_configuration_has_the_length_and_fields_of_the_manual(self):
        device = in_config_state()
        mid, data = ask(device, mtx.REQ_CONFIGURATION)
        self.assertEqual((mid, len(data)), (0x0D, 118))
        self.assertEqual(struct.unpack_from(">HH", data, 4), (1152, 0))
        self.assertEqual(struct.unpack_from(">HHI", data, 102), (52, 6, 0))

    def test_settings_are_kept_and_a_counter_makes_the_data_longer(self):
        device = in_config_state()
        self.assertEqual(ask(device, mtx.OUTPUT_SETTINGS, struct.pack(">I", 1)), (0xD3, b""))
        self.assertEqual(ask(device, mtx.REQ_DATA_LENGTH), (0x0B, struct.pack(">H", 0x36)))

    def test_errors_carry_their_code(self):
        device = in_config_state()
        self.assertEqual(ask(device, mtx.PERIOD, struct.pack(">H", 100)), (0x42, b"\x03"))
        self.assertEqual(ask(device, 0xC0), (0x42, b"\x04"))  # a legacy device

    def test_other_requests_are_ignored_while_measuring(self):
        self.assertEqual(mtx.Mtx(still).handle(mtx.frame(mtx.REQ_DEVICE_ID), 0.5), [])


class Data(unittest.TestCase):
    def test_samples_come_at_100_hz_with_their_counter_and_transmission_time(self):
        device = in_config_state()
        ask(device, mtx.OUTPUT_SETTINGS, struct.pack(">I", 1))
        ask(device, mtx.GO_TO_MEASUREMENT, now=3.001)
        sent = device.advance(3.1)
        times = [at for _, _, at in sent]
        np.testing.assert_allclose(np.diff(times), 0.01, atol=1e-12)
        arrival, data, at = sent[0]
        self.assertAlmostEqual(arrival - at, 59 * 10 / 115200, 9)
        (_, mid, body), = mtx.parse(data)[0]
        self.assertEqual((mid, len(body)), (mtx.MT_DATA, 54))
        values = struct.unpack(">13fH", body)
        np.testing.assert_allclose(values[:6], [*still(0)[0], *still(0)[1]], rtol=1e-6)
        counters = [struct.unpack(">H", mtx.parse(d)[0][0][2][-2:])[0] for _, d, _ in sent]
        self.assertEqual(set(np.diff(counters)), {1})

    def test_the_quaternion_is_in_the_legacy_frame_x_north_y_west(self):
        # The sensor's x points east: 90 degrees clockwise from north.
        device = mtx.Mtx(still)
        values = struct.unpack_from(">4f", device.measure(0.0), 36)
        half = np.sqrt(0.5)
        np.testing.assert_allclose(values, [half, 0.0, 0.0, -half], atol=1e-6)


class Port(unittest.TestCase):
    def test_unplugging_removes_the_port_and_plugging_brings_it_back(self):
        with tempfile.TemporaryDirectory() as folder:
            port = mtx.Port(os.path.join(folder, "mtx"))
            self.assertTrue(os.path.exists(port.link))
            port.unplug()
            self.assertFalse(os.path.lexists(port.link))
            port.write(b"lost")
            self.assertEqual(port.read(), b"")
            port.plug()
            host = os.open(port.link, os.O_RDWR | os.O_NOCTTY)
            port.write(b"\xfa\x0a\x0d")
            self.assertEqual(os.read(host, 10), b"\xfa\x0a\x0d")  # raw: nothing is translated
            os.close(host)
            port.unplug()


if __name__ == "__main__":
    unittest.main()
