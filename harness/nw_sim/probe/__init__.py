"""A policy looked at closely for some seconds: is its card what it was trained with?"""
