"""The fields of a foreign config file, with an account of each: read, passed over, or to be said.

A reader takes values of a `Fields`, which marks what it was asked for. What stays unread, and is
not in the table of what has no effect on a policy, is named in the draft; so is a value that is
there and cannot be read as what it should be.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, cast

from nw_policies.drafting.notation import plain

_SHOWN = 60
"""Fields of one file that are named."""
_PASSED_OVER: Mapping[str, Mapping[str, str]] = {
    "": {
        "it is a name": r"(.*\.)?(debug_vis|class_type|class_name|asset_name|comment)",
        "sensors of the evaluation have their own noise": r".*\.noise",
    },
    "deploy": {
        "the numbers of the motors say the same": r"joint_names|actions\.\w+\.joint_(names|ids)",
        "the evaluation commands no heading": r"commands\..*\.ranges\.heading",
        "its name says what it is": r"observations\..*params\.((asset|sensor)_cfg|command_name).*",
        "a card's frames are one row": r"observations\.\w+\.flatten_history_dim",
        "it is seen in the encoder": r"observations\..*params\.num_output_frames",
    },
    "io_descriptors": {
        "the robot has its own": r"""
            articulations\..*\.(joint_(pos|vel|effort)_limits|default_joint_(vel|pos_limits|
            vel_limits)|default_joint_(friction|viscous_friction|dynamic_friction).*|body_names|
            .*\bmass.*)
        """,
        "it is of the training": r"scene\.(num_envs|decimation|env_spacing|.*\.type)",
        "it describes an entry that is read by its name": r"""
            .*\.(dtype|mdp_type|extras|observation_type|action_type|units?|joint_ids|body_ids|
            axes|base_.*|full_path|name|joint_names|body_names|shape|modifiers|
            flatten_history_dim)
        """,
        "a critic's or another network's": r"observations\.(?!policy|actor)\w+",
    },
    "env": {
        "it steers the training": r"""
            rewards|terminations|events|curriculum|viewer|recorders|ui_window_class_type|seed|
            episode_length_s|is_finite_horizon|rerender_on_reset|wait_for_textures|xr|
            teleop_devices|log_dir|export_io_descriptors|num_rerenders_on_reset|metrics|
            scale_rewards_by_dt|auto_reset|num_actions|num_states|num_observations|state_space|
            action_space|observation_space|observation_noise_model|action_noise_model|
            distance_metric|\w*reward\w*|\w*_scale_range|contact_sensor|terrain
        """,
        "the evaluation has its own physics": r"sim\.(?!dt|mujoco\.timestep).*",
        "the evaluation has its own scenes": r"""
            scene\.(?!robot|entities|height_scanner)\w+(\..*)?|scene\.entities\.(?!robot)\w+.*
        """,
        "heights are looked up in the scene": r"""
            scene\.height_scanner\.(class_type|update_period|debug_vis|max_distance|
            mesh_prim_paths|(ray_cast_)?drift_range(\..*)?|visualizer_cfg(\..*)?|history_length|
            pattern_cfg\.func)
        """,
        "the robot is ours": r"""
            (scene\.(entities\.)?)?robot\.(prim_path|spawn|spawn_fn|collision_group|collisions|
            articulation_root_prim_path|soft_joint_pos_limit_factor|
            init_state\.(?!joint_pos)\w+|articulation\.soft_joint_pos_limit_factor|
            actuator_value_resolution_debug_print|sites|lights|materials|textures|cameras|
            sort_actuators)
        """,
        "limits of speed count in a torque-speed curve alone": r"""
            .*actuators\.\w+\.(velocity_limit(_sim)?|effort_limit_sim|transmission_type)
        """,
        "a critic's or another network's": r"observations\.(?!policy|actor)\w+",
        "a card's terms are one row, told apart by their functions": r"""
            observations\.\w+\.(concatenate_terms|concatenate_dim|enable_corruption|nan_policy|
            nan_check_per_term|flatten_history_dim|history_ordering)|
            observations\.\w+\.\w+\.(flatten_history_dim|params(\..*)?)
        """,
        "the evaluation commands velocities": r"commands\.\w+\.(?!ranges\.(lin_vel|ang_vel))\w+",
        "all joints": r"actions\.\w+\.(joint_names|actuator_names|entity_name|preserve_order)",
    },
    "agent": {
        "it steers the training, or is seen in the tensors": r"""
            (?!.*(clip_actions|clip_observations|output|activations?|preprocessor\w*|
            normali[sz]\w*|squash\w*|tanh\w*)$).*
        """,
        "a critic's": r"critic|models\.value|.*value\w*",
        "in the tensors": r".*(state|observation|amp_state)_preprocessor\w*(\..*)?|.*normaliz\w+",
        "it steers the training": r"(.*\.)?(normalize_advantage\w*|.*value_preprocessor\w*)",
    },
    "gym_training": {
        "it steers the training, or is drawn": r"""
            (Cfg\.)?(?!Cfg\.|control|normalization\.clip_|init_state\.default|sim\.dt)\w+(\..*)?|
            (Cfg\.)?(sim|init_state|domain_rand|normalization)\.\w+(\..*)?
        """,
    },
    "legged_rl_deploy": {
        "it moves the robot before and after the policy": r"(?!policy\.).*",
        "it is a name": r"policy\.(name|model_type|onnx\w*|commands\.\w+\.(name|type))",
        "a card clips, then scales": r".*\.process_order",
    },
    "rl_sar": {
        "it is of the controller": r"""
            (.*\.)?(model_name|framework|num_observations|rows|cols|use_history|fixed_kp|
            fixed_kd|joint_controller_names|wheel_indices|ang_vel_axis|ang_vel_type|
            inference_\w+|waist_joint_indices)
        """,
    },
    "gym": {
        "it is of the script, or moves the robot before the policy": r"""
            xml_path|simulation_duration|msg_type|imu_type|lowcmd_topic|lowstate_topic|
            weak_motor|stand_kp|stand_kd|stand_time|damping_kd|policy_path|policy_name|cmd_init|
            arm_waist_\w+|network|net|domain_id|interface
        """,
        "the robot has its own": r"joint_vel_limit\w*|joint_pos_limit\w*",
    },
    "booster": {
        "it moves the robot before the policy": r"prepare|mech",
        "it is seen": r"policy\.(policy_path|num_\w+)",
    },
    "limx": {
        "it moves the robot before the policy": r"\w+\.stand_mode",
        "it is seen": r"\w+\.(size\.\w+|normalization\.obs_scales\.lin_vel)",
        "the robot's IMU is ours": r"\w+\.imu_orientation_offset",
    },
    "humanoidverse_train": {
        "it steers the training": r"""
            (?!(robot|obs|simulator|domain_rand)(\..*)?$).*|domain_rand\.(?!.*ctrl_delay).*|
            obs\.(noise_scales|noise_\w+|add_noise\w*|soft_\w+|obs_dims|post_compute_config|
            motion_len|obs_dict\.(?!actor_obs).*|obs_auxiliary\.(?!history_actor).*)
        """,
        "a term that the policy does not see": r"obs\.obs_scales\.\w+",
        "the evaluation has its own physics": r"simulator\.(?!config\.sim\.(fps|control_dec)).*",
        "the robot is ours": r"""
            robot\.(?!(control|init_state|motion)(\..*)?$).*|robot\.init_state\.(pos|rot|\w+_vel)|
            robot\.control\.(isaac_pd_scale|clamp_actions|clip_torques)|
            robot\.motion\.(?!motion_file).*
        """,
    },
    "humanoidverse_deploy": {
        "it is of the script, of the simulator or of the wire": r"""
            [A-Z_]*(ROBOT|ASSET|SDK|MOTOR|SIM|DOMAIN|INTERFACE|FREE|PRINT|ELASTIC|VIEWER|SENSOR|
            JOYSTICK|VISUALIZE|UNITREE|NUM|Weak)\w*|ENABLE_\w+|USE_\w+|use_upper_body_controller|
            (left|right)_hand_link_name|JOINT2MOTOR|NET|obs_dims
        """,
        "the robot has its own": r"motor_(pos|vel)\w*limit\w*",
        "a term that the policy does not see": r"obs_scales\.\w+",
    },
    "legged_ros2": {
        "it is of the controller": r"(?!.*ros__parameters\.(obs|action)_cfg).*",
    },
    "leapp": {
        "the flow and the files say the same": r"""
            models\.[^.]+\.(in|out)puts\.\d+\.(dtype|type)|.*\.(md5sum|opset_version)|
            pipeline\.(in|out)puts\..*
        """,
        "it says where it is from": r"system.information|metadata|version|leapp\w*",
    },
    "muwanx": {
        "it is said of the groups": r"onnx(\..*)?|obs_config\.(?!policy)\w+",
    },
}
"""Fields without effect on a card, by the kind of their file, of all kinds first: the reason, and
a verbose pattern of their paths; what lies below one is passed over, too."""


class Fields(dict[str, Any]):
    """A mapping of a file, whose mappings are such too; it marks which keys were asked for.

    `get` and `[]` ask; to go through `items` or `values` asks for none of the values.
    """

    def __init__(self, data: Mapping[str, Any] | None = None) -> None:
        super().__init__({str(key): _kept(value) for key, value in (data or {}).items()})
        self._read: set[str] = set()
        self._odd: set[str] = set()

    def __getitem__(self, key: str) -> Any:
        self._read.add(key)
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        """Return a value, as `dict.get`, and mark it as read."""
        self._read.add(key)
        return super().get(key, default)

    def first(self, *keys: str) -> tuple[str, Any]:
        """Return the first key that says something, and what; the last and None if none does."""
        key = next((key for key in keys if super(Fields, self).get(key) is not None), keys[-1])
        return key, self.get(key)

    def below(self, key: str) -> Fields:
        """Return the mapping of a key; an empty one if the key has no mapping."""
        value = self.get(key)
        self.doubt(key, value, readable=isinstance(value, Fields))
        return value if isinstance(value, Fields) else Fields()

    def number(self, *keys: str) -> float | None:
        """Return the value of the first present key as a finite number; None if it is not one."""
        key, value = self.first(*keys)
        number = number_of(value)
        self.doubt(key, value, readable=number is not None)
        return number

    def numbers(self, *keys: str) -> tuple[float, ...]:
        """Return a list of finite numbers, or one; empty where it is something else."""
        key, value = self.first(*keys)
        numbers = numbers_of(value)
        self.doubt(key, value, readable=bool(numbers))
        return numbers

    def texts(self, key: str) -> tuple[str, ...]:
        """Return the texts of a list; empty where it is none."""
        value = self.get(key)
        texts = texts_of(value)
        is_whole = isinstance(value, list) and len(texts) == len(cast("list[Any]", value))
        self.doubt(key, value, readable=is_whole)
        return texts

    def limits(self, key: str) -> tuple[float, float] | None:
        """Return [low, high], or one number for both sides, or a list of equal pairs."""
        value = self.get(key)
        limits = limits_of(value)
        self.doubt(key, value, readable=limits is not None or value in (0, [0.0], False))
        return limits

    def per_second(self, key: str) -> float | None:
        """Return how often a time of seconds passes in one."""
        return per_second(self.number(key))

    def doubt(self, key: str, value: Any, *, readable: bool = False) -> None:
        """Note that a value is there and could not be read, unless it could."""
        if not readable and value not in (None, "", [], {}):
            self._odd.add(key)

    @property
    def is_read(self) -> bool:
        """Whether anything of it was asked for that is there."""
        inner = (item for value in super().values() for _, item in _inner(value))
        return bool(self._read & set(self)) or any(item.is_read for item in inner)

    def unread(self) -> Iterator[tuple[str, bool, Any]]:
        """Give the path of each field that was not read or is odd, whether it is, and its value."""
        for key, value in super().items():
            if key in self._odd:
                yield key, True, value
                continue
            items = _inner(value)
            if not items and key not in self._read and value not in (None, "", [], {}, False):
                yield key, False, value
            for name, inner in items:
                for path, odd, leaf in inner.unread():
                    yield ".".join(filter(None, (key, name, path))), odd, leaf


def _kept(value: Any) -> Any:
    if isinstance(value, dict):
        return Fields(cast("dict[str, Any]", value))
    return [_kept(item) for item in cast("list[Any]", value)] if isinstance(value, list) else value


def _inner(value: Any) -> list[tuple[str, Fields]]:
    if isinstance(value, Fields):
        return [("", value)]
    items = cast("list[Any]", value) if isinstance(value, list) else []
    return [(str(index), item) for index, item in enumerate(items) if isinstance(item, Fields)]


def is_passed_over(path: str, kind: str) -> bool:
    """Whether a field of a kind of file has no effect on a card."""
    rules = _PASSED_OVER.get(kind, {}).values()
    return any(re.fullmatch(rf"(?:{rule})(\..*)?", path, re.VERBOSE) for rule in rules)


def account(name: str, kinds: Iterable[str], data: Fields) -> tuple[str, ...]:
    """Return sentences that name what readers left of a file; none where nothing is left.

    Args:
        name: of the file.
        kinds: as `configs.reader_of` calls those whose readers have read it.
        data: the fields that they have read.
    """
    odd: list[str] = []
    left: dict[str, None] = {}
    for path, is_odd, value in data.unread():
        if is_odd:
            odd.append(f"{path} cannot be read: {str(value)[:80]}")
        elif not any(is_passed_over(path, kind) for kind in ("", *kinds)):
            left[path] = None
    notes = [plain(f"{name}: {sentence}") for sentence in odd[:_SHOWN]]
    if left:
        shown = [plain(path) for path in left][:_SHOWN]
        more = f" and {len(left) - _SHOWN} more" * (len(left) > _SHOWN)
        notes.append(f"{plain(name)} has what this card does not: {', '.join(shown)}{more}")
    return tuple(notes)


def number_of(value: Any) -> float | None:
    """Return a value as a finite number; None if it is not one."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    try:
        return number if math.isfinite(number := float(value)) else None
    except OverflowError:  # An integer of hundreds of digits.
        return None


def numbers_of(value: Any) -> tuple[float, ...]:
    """Return a list of finite numbers, or one; empty where it is something else."""
    items = cast("list[Any]", value) if isinstance(value, list) else [value]
    numbers = [number_of(item) for item in items]
    return () if None in numbers else tuple(cast("list[float]", numbers))


def texts_of(value: Any) -> tuple[str, ...]:
    """Return the texts of a list; empty where it is none."""
    items = cast("list[Any]", value) if isinstance(value, list) else []
    return tuple(item for item in items if isinstance(item, str))


def limits_of(value: Any) -> tuple[float, float] | None:
    """Return [low, high], or one number for both sides, or a list of equal pairs."""
    items = cast("list[Any]", value) if isinstance(value, list) else []
    if items and all(pair == items[0] for pair in items):
        value = items[0] if isinstance(items[0], list) else items
    numbers = numbers_of(value)
    if len(numbers) == 1 and numbers[0] > 0:
        return -numbers[0], numbers[0]
    return (numbers[0], numbers[1]) if len(numbers) == 2 and numbers[0] < numbers[1] else None


def per_second(seconds: float | None) -> float | None:
    """Return how often a time passes in a second, Hz."""
    return round(1 / seconds, 6) if seconds else None
