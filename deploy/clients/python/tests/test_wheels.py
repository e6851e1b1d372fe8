"""Tests of the kinematics of the wheels."""

import math
import unittest

from coxswain.wheels import rows


class Wheels(unittest.TestCase):
    def assert_rows(self, found: tuple, expected: tuple) -> None:
        self.assertEqual(len(found), len(expected))
        for row, other in zip(found, expected):
            for a, b in zip(row, other):
                self.assertAlmostEqual(a, b, 12)

    def test_mecanum_wheels_have_the_rows_of_the_paper(self) -> None:
        found = rows({"mecanum": {"radius_m": 0.05, "wheelbase_m": 0.25, "track_m": 0.3}})
        signs = ((1, 1, 1), (1, -1, -1), (1, 1, -1), (1, -1, 1))
        paper = tuple((f / 0.05, s / 0.05, t * 0.275 / 0.05) for f, s, t in signs)
        self.assert_rows(found, paper)

    def test_a_list_of_wheels_is_the_same_as_its_shorthand(self) -> None:
        places = ((0.1, -0.3, -45), (0.1, 0.3, 45), (-0.1, 0.3, -45), (-0.1, -0.3, 45))
        wheels = [{"position_m": (x, y), "roller_deg": r, "radius_m": 0.05} for x, y, r in places]
        shorthand = {"radius_m": 0.05, "wheelbase_m": 0.2, "track_m": 0.6, "rollers": "X"}
        self.assert_rows(rows({"list": wheels}), rows({"mecanum": shorthand}))
        angles = [2 * math.pi * wheel / 3 for wheel in range(3)]
        wheels = [
            {
                "position_m": (0.2 * math.cos(angle), 0.2 * math.sin(angle)),
                "direction_deg": math.degrees(angle) + 90,
                "radius_m": 0.04,
            }
            for angle in angles
        ]
        shorthand = {"radius_m": 0.04, "centre_to_wheel_m": 0.2, "count": 3}
        self.assert_rows(rows({"list": wheels}), rows({"omni": shorthand}))

    def test_a_base_without_known_wheels_has_none(self) -> None:
        self.assertEqual(rows({"twist": {"length_m": 1.0, "width_m": 0.8}}), ())
        with self.assertRaises(ValueError):
            rows({"tracks": {}})
        with self.assertRaises(ValueError):
            rows({"twist": {"length_m": 1.0, "width_m": 0.8}, "list": []})


if __name__ == "__main__":
    unittest.main()
