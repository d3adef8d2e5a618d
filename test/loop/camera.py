"""Images of the climber's camera from MuJoCo's offscreen renderer.

A pinhole camera without distortion, one instant per image (a short exposure, whose middle is the
stamp), four samples a pixel. Noise is added as a sensor has it: Gaussian, plus photon noise that
grows with brightness.
"""

import io

import numpy as np
from PIL import Image

import crane as c
from crane import mujoco

READ_NOISE = 1.2  # gray values in the dark
SHOT_NOISE = 0.02  # variance per gray value
SIGMA = np.sqrt(READ_NOISE**2 + SHOT_NOISE * np.arange(256)).astype(np.float32)  # by gray value
QUALITY = 90  # JPEG, color not subsampled


class Camera:
    """Renders the crane."""

    def __init__(self, crane, seed):
        self.crane = crane
        self.renderer = mujoco.Renderer(crane.model, c.HEIGHT_PX, c.WIDTH)
        flags = self.renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self.random = np.random.default_rng(seed)
        # Drawing a million normal numbers per image is slow: each image takes another part.
        self.noise = self.random.standard_normal(8_000_000, dtype=np.float32)

    def render(self):
        """Image without noise, (480, 640, 3) uint8, RGB."""
        self.crane.place_cover()
        mujoco.mj_forward(self.crane.model, self.crane.data)
        self.renderer.update_scene(self.crane.data, "climber_camera")
        return self.renderer.render()

    def shoot(self):
        """A JPEG of what the camera sees now."""
        image = self.render()
        start = self.random.integers(self.noise.size - image.size)
        noisy = SIGMA[image]
        noisy *= self.noise[start : start + image.size].reshape(image.shape)
        noisy += image
        noisy += 0.5
        return encode(np.clip(noisy, 0, 255, out=noisy).astype(np.uint8))

    def close(self):
        """Frees the renderer."""
        self.renderer.close()


def encode(image):
    """JPEG of an RGB image."""
    out = io.BytesIO()
    Image.fromarray(image).save(out, "JPEG", quality=QUALITY, subsampling=0)
    return out.getvalue()
