"""Times of images are moved; nothing else of a log is."""

from __future__ import annotations

import pytest
from small_log import IMAGE_TIMES, write_edge_log, write_small_log

from localiser.errors import InputError
from localiser.storage import images_table, move_images, open_log


def test_every_image_is_moved_and_the_old_table_is_kept(tmp_path):
    log = write_small_log(tmp_path / "log")
    path = images_table(log)
    before = path.read_text()
    kept = move_images(path, 30_000_000)
    assert (kept.name, kept.read_text()) == ("images.csv.bak", before)
    assert [frame.t_ns for frame in open_log(log).frames] == [t_ns + 30_000_000 for t_ns in IMAGE_TIMES]
    assert move_images(path, -30_000_000).name == "images.csv.bak2"
    assert path.read_text() == before


def test_the_order_of_columns_stays(tmp_path):
    path = tmp_path / "images.csv"
    path.write_text('file,t_ns\n"images/a, b.png",5\nimages/c.png,1000000007\n')
    move_images(path, -10)
    assert path.read_text() == 'file,t_ns\n"images/a, b.png",-5\nimages/c.png,999999997\n'


def test_a_damaged_table_is_left_alone(tmp_path):
    path = tmp_path / "images.csv"
    path.write_text("t_ns,file\n5,a.png\nx,b.png\n")
    with pytest.raises(InputError, match=r"images.csv:3.*integer"):
        move_images(path, 10)
    assert list(tmp_path.iterdir()) == [path] and "x,b.png" in path.read_text()


def test_what_is_no_folder_with_images_is_told(tmp_path):
    with pytest.raises(InputError, match="localiser convert"):
        images_table(tmp_path / "drive.mcap")
    with pytest.raises(InputError, match="images"):
        images_table(write_edge_log(tmp_path / "log"))
