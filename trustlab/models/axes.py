"""Where results draw themselves: on axes that the user gives, or on those of a new figure."""


def axes_or_new(axes=None, rows: int = 1, columns: int = 1, title: str = "", **options):
    """
    Return the Matplotlib axes given, or those of a new figure with this title; options are those of
    `plt.subplots`.
    """
    if axes is not None:
        return axes
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(rows, columns, layout="constrained", **options)
    if title:
        figure.suptitle(title, fontsize="medium")
    return axes
