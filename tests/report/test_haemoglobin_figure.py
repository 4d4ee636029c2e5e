"""The paper's Fig. 4 from the shipped tables."""

from nailoptics.report import style
from nailoptics.report.pages.paper import CROSSES_BETWEEN_NM, crossing_nm, draw_haemoglobins


def test_both_haemoglobins_cross_where_the_table_has_them_equal():
    """796.8 nm in the table of S. Prahl, as its header's source has it."""
    assert abs(crossing_nm() - 796.8) < 0.1
    assert CROSSES_BETWEEN_NM[0] - 0.5 < crossing_nm() < CROSSES_BETWEEN_NM[1]


def test_the_figure_is_drawn_into_a_folder(tmp_path):
    path = draw_haemoglobins(tmp_path / "new")
    assert path.name == "haemoglobin_fig4.png" and path.stat().st_size > 10_000


def test_a_figure_is_written_as_matplotlib_itself_would(tmp_path):
    """Expected: the bytes of `Figure.savefig`, which draws a figure whose layout is computed twice."""

    def drawn():
        figure, axes = style.panels(4.0, 2.5, 1, 2)
        axes[0].plot([0.0, 1e4], [0.0, 1e-3], label="a line")
        axes[1].set(title="A title", xlabel="an axis [mm]", ylabel="another")
        style.legend_above(figure, axes[0], ncols=1)
        return figure

    style.write_figure(drawn(), tmp_path / "ours.png", dpi=90)
    drawn().savefig(tmp_path / "theirs.png", dpi=90, facecolor="white")
    assert (tmp_path / "ours.png").read_bytes() == (tmp_path / "theirs.png").read_bytes()
