"""A student so small that it learns something within seconds, or nothing at all."""

from nw_eval.learn.student.config import StudentConfig


def small_config(**changes):
    text = {
        "nw-train": 1,
        "seed": 3,
        "name": "pupil",
        "device": "cpu",
        "budget": {"steps": 600},
        "scenes": ["hurdles/one_low_carpet"],
        "rounds": 2,
        "trajectories": 2,
        "duration": 0.6,
        "sees": {"width": 16, "height": 16, "frames": 2},
        "network": {"chunk": 4, "width": 16, "heads": 2, "feedforward": 16, "convolutions": [8, 8]},
        "learns": {"batch_images": 4},
    }
    return StudentConfig.model_validate(text | changes)
