import numpy as np

from occlog.records.scene import Occluder, Scene

L_ROOM = np.array([[0.0, 0.0], [160.0, 0.0], [160.0, 53.0], [53.0, 53.0], [53.0, 160.0], [0.0, 160.0]])
PILLAR = np.array([[20.0, 20.0], [30.0, 20.0], [30.0, 30.0]])


def test_pillars_and_the_walls_of_a_bent_room_block():
    scene = Scene(room=L_ROOM, occluders=(Occluder("pillar", PILLAR),))
    polygons = scene.blockers(np.array([0.0, 160.0]))
    assert len(polygons) == 2
    assert (polygons[0] == PILLAR).all()


def test_a_pocket_that_holds_the_sensor_does_not_block():
    assert Scene(room=L_ROOM).blockers(np.array([60.0, 60.0])) == ()
    assert len(Scene(room=L_ROOM).blockers(np.array([150.0, 150.0]))) == 1  # behind the hull's side: outside
    assert Scene().blockers(np.zeros(2)) == ()
