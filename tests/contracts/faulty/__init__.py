"""One deliberately faulty plugin for every check: the tiny plugin of the kind, with a single fault."""
