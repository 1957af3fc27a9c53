# SPDX-License-Identifier: BSD-3-Clause
import re
import shutil
import zipfile

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io import image_decoding
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import Frame, SkippedFrame


def rewrite(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def images_of(folder):
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted((folder / "images").iterdir())]


def into_zip(folder, prefix):
    with zipfile.ZipFile(folder / "images.zip", "w") as archive:
        for path in (folder / "images").iterdir():
            archive.write(path, prefix + path.name)
    shutil.rmtree(folder / "images")


def test_a_complete_folder(tum_folder):
    recording = open_recording(tum_folder)
    frames = list(recording.frames())

    assert (recording.name, len(recording)) == ("tour", 6)
    assert recording.calibration.camera.parameters.tolist() == [60.0, 61.0, 47.5, 39.5]
    assert [frame.stamp_ns for frame in frames][:2] == [1_700_000_001_000_042_017, 1_700_000_001_100_042_017]
    assert [frame.exposure_ms for frame in frames] == pytest.approx([5.0, 5.1, 5.2, 5.3, 5.4, 5.5])
    for frame, image in zip(frames, images_of(tum_folder)):
        np.testing.assert_array_equal(frame.image, image)
    assert recording.wheels.stamps_ns.tolist() == [1_700_000_001_000_000_000 + k * 20_000_000 for k in range(3)]
    assert recording.wheels.readings.tolist() == [[10, -20], [15, -18], [21, -15]]
    assert recording.robot.wheel_radius_m == (0.098, 0.099)
    np.testing.assert_allclose(recording.robot.T_base_camera[:3, 3], [0.18, 0.04, 0.62])
    assert recording.ground_truth_path == tum_folder / "groundtruth.tum"


@pytest.mark.parametrize("prefix", ["", "images/"])
def test_images_in_an_archive(tum_folder, prefix):
    images = images_of(tum_folder)
    into_zip(tum_folder, prefix)
    frames = list(open_recording(tum_folder).frames())
    for frame, image in zip(frames, images):
        np.testing.assert_array_equal(frame.image, image)


def test_only_images_times_and_camera_are_needed(tum_folder):
    for name in ("encoders.csv", "robot.yaml", "groundtruth.tum"):
        (tum_folder / name).unlink()
    recording = open_recording(tum_folder)
    assert recording.wheels is recording.robot is recording.ground_truth_path is None
    assert len(list(recording.frames())) == 6


def test_ids_may_be_padded_differently_and_exposures_be_missing(tum_folder):
    (tum_folder / "times.txt").write_text("# id stamp\n0 10.5\n0000001 10.6 0\n2 10.7 3.5\n")
    frames = list(open_recording(tum_folder).frames())
    assert [frame.stamp_ns for frame in frames] == [10_500_000_000, 10_600_000_000, 10_700_000_000]
    assert [frame.exposure_ms for frame in frames] == [None, None, 3.5]
    np.testing.assert_array_equal(frames[1].image, images_of(tum_folder)[1])


def test_other_camera_and_robot_files(tum_folder, tmp_path):
    (tmp_path / "camera.txt").write_text("Pinhole 70 71 47.5 39.5 0\n96 80\nnone\n96 80\n")
    (tmp_path / "robot.yaml").write_text((tum_folder / "robot.yaml").read_text().replace("4096", "1000"))
    (tum_folder / "camera.txt").unlink()
    recording = open_recording(tum_folder, camera_file=tmp_path / "camera.txt", robot_file=tmp_path / "robot.yaml")
    assert recording.calibration.camera.fx == 70
    assert recording.robot.ticks_per_turn == 1000


def test_photometric_files_are_read(tum_folder):
    (tum_folder / "pcalib.txt").write_text(" ".join(str(value**2) for value in range(256)))
    cv2.imwrite(str(tum_folder / "vignette.png"), np.full((80, 96), 200, np.uint8))
    photometric = open_recording(tum_folder).photometric
    assert photometric.inverse_response[128] == pytest.approx(128**2 / 255)
    assert (photometric.vignette == 1).all()


def test_bad_images_are_skipped_and_named(tum_folder):
    images = tum_folder / "images"
    (images / "00001.png").write_bytes((images / "00001.png").read_bytes()[:200])
    cv2.imwrite(str(images / "00002.png"), np.zeros((40, 48), np.uint8))
    (images / "00003.png").unlink()
    (images / "00004.png").write_bytes(b"")
    frames = list(open_recording(tum_folder).frames())
    assert [frame.reason for frame in frames if isinstance(frame, SkippedFrame)] == [
        f"{images}/00001.png: truncated image: its 200 bytes have no end mark; frame skipped",
        f"{images}/00002.png: the image is 48x40, but the calibration is for 96x80; frame skipped",
        f"{tum_folder}/times.txt, line 4: the image is not in {images}; frame skipped",
        f"{images}/00004.png: not a readable image (0 bytes); frame skipped",
    ]
    assert sum(isinstance(frame, Frame) for frame in frames) == 2


def test_a_damaged_image_in_an_archive_is_skipped(tum_folder):
    into_zip(tum_folder, "images/")
    content = bytearray((tum_folder / "images.zip").read_bytes())
    content[600] ^= 0xFF
    (tum_folder / "images.zip").write_bytes(bytes(content))
    frames = list(open_recording(tum_folder).frames())
    skipped = [frame.reason for frame in frames if isinstance(frame, SkippedFrame)]
    assert len(skipped) == 1
    assert re.match(
        rf"{re.escape(str(tum_folder))}/images.zip/images/0000\d.png: cannot read the image: Bad CRC", skipped[0]
    )


@pytest.mark.parametrize("stamps", ["repeated", "unsorted"])
def test_stamps_that_do_not_grow_are_skipped(tum_folder, stamps):
    wrong = "1700000001.100042017" if stamps == "repeated" else "1700000001.050000000"
    rewrite(tum_folder / "times.txt", "1700000001.200042017", wrong)
    frames = list(open_recording(tum_folder).frames())
    assert [isinstance(frame, Frame) for frame in frames] == [True, True, False, True, True, True]
    how = "repeats" if stamps == "repeated" else "lies before"
    assert frames[2].reason == (
        f"{tum_folder}/images/00002.png: the stamp {wrong} {how} that of the last frame; frame skipped"
    )


def remove(name):
    def change(folder):
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return change


def empty(name):
    def change(folder):
        for path in (folder / name).iterdir():
            path.unlink()

    return change


def write(name, text):
    def change(folder):
        (folder / name).write_text(text)

    return change


def broken_archive(folder):
    shutil.rmtree(folder / "images")
    (folder / "images.zip").write_bytes(b"PK no archive")


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (
            remove("images"),
            ": neither images/ nor images.zip is in it; a recording is a ROS 1 bag or a folder",
        ),
        (empty("images"), "/images: there are no images in it"),
        (broken_archive, "/images.zip: cannot read the archive: File is not a zip file"),
        (remove("times.txt"), "/times.txt: cannot read the file: No such file or directory"),
        (write("times.txt", "\n"), "/times.txt: it lists no images; expected lines of 'id stamp exposure_ms'"),
        (write("times.txt", "0 1.5\n1\n"), "/times.txt, line 2: 1 words; expected 'id stamp exposure_ms'"),
        (write("times.txt", "0 1.5 x\n"), "/times.txt, line 1: could not convert string to float: 'x'; expected 'id"),
        (write("times.txt", "0 nan\n"), "/times.txt, line 1: 'nan' is not a time in seconds; expected 'id stamp expo"),
        (write("times.txt", "0 1.5 -2\n"), "/times.txt, line 1: the exposure -2 is impossible; it is in milliseconds"),
        (write("times.txt", "90 1.5\n"), "/times.txt: none of the images listed is in"),
        (remove("camera.txt"), "/camera.txt: cannot read the file: No such file or directory"),
        (write("camera.txt", "Pinhole 1 2 3\n"), "/camera.txt: 1 lines instead of 4"),
        (write("pcalib.txt", "1 2 3"), "/pcalib.txt: 3 values instead of the 256 of the inverse response"),
        (write("vignette.png", ""), "/vignette.png: not a readable image (0 bytes)"),
    ],
)
def test_folders_of_no_recording(tum_folder, change, complaint):
    change(tum_folder)
    with pytest.raises(InputError, match=re.escape(f"{tum_folder}{complaint}")) as caught:
        open_recording(tum_folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("stamp,left,right\n", ": there are no ticks in it"),
        ("stamp,left,right\n1.0,2\n", ", line 2: '1.0,2'; expected 'stamp,left,right', ticks as whole numbers"),
        ("1.0,2,3.5\n", ", line 1: '1.0,2,3.5'; expected 'stamp,left,right', ticks as whole numbers"),
        ("1.0,2,3\n1.0,2,3\n", ", line 2: the stamp is that of the line before; remove one of the two"),
        ("1.0,2,3\n0.9,2,3\n", ", line 2: the stamp is not later than the one before; sort the file"),
    ],
)
def test_ticks_of_no_wheels(tum_folder, text, complaint):
    (tum_folder / "encoders.csv").write_text(text)
    with pytest.raises(InputError, match=re.escape(f"{tum_folder}/encoders.csv{complaint}")):
        _ = open_recording(tum_folder).wheels


def test_an_image_that_is_listed_twice_is_used_once(tum_folder):
    """The image was taken at one of the times: the other would be that of another pose."""
    with (tum_folder / "times.txt").open("a") as times:
        times.write("2 1700000001.600042017 5.0\n00005 1700000001.700042017 5.0\n")
    frames = list(open_recording(tum_folder).frames())
    assert [isinstance(frame, Frame) for frame in frames] == [True] * 6 + [False] * 2
    assert frames[6].reason == f"{tum_folder}/images/00002.png: times.txt lists the image twice; frame skipped"


def test_float_images(tum_folder):
    for path in sorted((tum_folder / "images").glob("*.png")):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(path.with_suffix(".tif")), picture.astype(np.float32) / 255)
        path.unlink()
    frames = list(open_recording(tum_folder).frames())
    assert len(frames) == 6
    assert {frame.image.dtype for frame in frames} == {np.dtype(np.float32)}
    assert 0.8 < frames[0].image.max() <= 1.0


def test_members_of_an_archive_stay_in_it(tum_folder, tmp_path):
    """Only names are compared; nothing is unpacked, and no path is made of what an archive or times.txt says."""
    into_zip(tum_folder, "../../../outside/")
    (tmp_path / "secret.png").write_bytes(b"not to be read")
    times = tum_folder / "times.txt"
    times.write_text(times.read_text() + "../secret 1700000009 5\n/dev/zero 1700000010 5\n")
    before = sorted(tmp_path.rglob("*"))
    frames = list(open_recording(tum_folder).frames())
    assert [isinstance(frame, Frame) for frame in frames] == [True] * 6 + [False] * 2
    assert "the image is not in" in frames[-1].reason
    assert sorted(tmp_path.rglob("*")) == before


def test_a_member_that_becomes_too_large_is_not_unpacked(tum_folder, monkeypatch):
    with zipfile.ZipFile(tum_folder / "images.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for path in (tum_folder / "images").iterdir():
            archive.writestr(path.name, bytes(2 * 10**6))
    shutil.rmtree(tum_folder / "images")
    assert (tum_folder / "images.zip").stat().st_size < 10**5
    monkeypatch.setattr(image_decoding, "MOST_IMAGE_BYTES", 10**6)
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *_: pytest.fail("was unpacked"))
    skipped = list(open_recording(tum_folder).frames())
    assert [frame.kind for frame in skipped] == ["the image has 2000000 bytes, more than 1000000"] * 6


def test_a_file_that_is_too_large_is_not_read(tum_folder, monkeypatch):
    monkeypatch.setattr(image_decoding, "MOST_IMAGE_BYTES", 10**6)
    with (tum_folder / "images" / "00002.png").open("wb") as file:
        file.truncate(2**40)
    frames = list(open_recording(tum_folder).frames())
    assert frames[2].kind == f"the image has {2**40} bytes, more than 1000000"
    assert sum(isinstance(frame, Frame) for frame in frames) == 5


def test_an_encrypted_archive(tum_folder):
    into_zip(tum_folder, "")
    path = tum_folder / "images.zip"
    content = bytearray(path.read_bytes())
    for magic, flags in ((b"PK\x01\x02", 8), (b"PK\x03\x04", 6)):
        at = content.find(magic)
        while at >= 0:
            content[at + flags] |= 1
            at = content.find(magic, at + 1)
    path.write_bytes(bytes(content))
    skipped = list(open_recording(tum_folder).frames())
    assert len(skipped) == 6
    assert all("cannot read the image: File" in frame.reason and "encrypted" in frame.reason for frame in skipped)
