"""What lies on the hub: a scene of one box, and a policy that stands."""

SCENE = b"""\
nw-scene: 1
name: far/corridor
task: hurdles
licence: MIT
collision: collision.yaml
trail: [[1.0, 0, 0.05], [2.0, 0, 0]]
"""
BOXES = b"boxes: [{center: [1, 0, 0.025], half_size: [0.1, 1, 0.025]}]\n"
LARGE_FILE = bytes(range(250)) * 8000
CARD = b"""\
nw-policy: 1
name: still
robot: go1
adapter: zero
control: {action: joint_position_offset, scale: 0.25}
"""
