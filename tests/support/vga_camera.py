"""The camera of many tests: 640 × 480 pixels, focal length 554 px, principal point in the middle."""

from localiser.camera import Camera, Mount


def vga_camera(mount: Mount, lens: str = "none", distortion: tuple[float, ...] = ()) -> Camera:
    return Camera(640, 480, 554.0, 554.0, 319.5, 239.5, mount, lens, distortion)
