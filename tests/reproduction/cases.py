"""Studies as a paper prints them, in a line."""

from trustlab import PublishedStudy


def study_of(text, **more):
    """Return the study that prints "n = 20, mean.A = 5.0, …"; of what is there twice, the last."""
    fields = {"sd": {}}
    for name, number in (each.split(" = ") for each in text.split(", ")):
        field, _, key = name.partition(".")
        if key:
            fields.setdefault(field, {})[key] = number
        else:
            fields[field] = number
    fields["n"] = int(fields["n"])
    if "scale" in fields:
        fields["scale"] = tuple(map(float, fields["scale"].split(" to ")))
    return PublishedStudy("s", **fields | more)
