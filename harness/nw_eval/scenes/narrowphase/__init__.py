"""Contacts of a robot's shapes with scanned ground, in place of MuJoCo's own."""
