import numpy as np

from nw_eval import Score, ScoreSpec


class MaxTilt(Score):
    spec = ScoreSpec(
        name="max_tilt",
        unit="rad",
        better="lower",
        low=0.0,
        high=3.2,
        undefined=3.2,
        meaning="largest angle between the trunk's z axis and the vertical",
    )

    def __init__(self, figures):
        super().__init__(figures)
        self.most = 0.0

    def update(self, stretch):
        roll, pitch, _ = stretch.roll_pitch_yaw.T
        tilts = np.arccos(np.cos(roll) * np.cos(pitch))
        self.most = max(self.most, float(tilts.max()))

    def value(self, end):
        return self.most
