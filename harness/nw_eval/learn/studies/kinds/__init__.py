"""The studies that there are: whom each trains, what it reckons, how it draws it."""
