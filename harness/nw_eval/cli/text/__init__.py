"""What the verbs print: the api's values as lines of text, a module for each kind of them."""
