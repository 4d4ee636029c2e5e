"""The paper's Fig. 4 from the shipped tables."""

from nailoptics.report.pages.paper import CROSSES_BETWEEN_NM, crossing_nm, draw_haemoglobins


def test_both_haemoglobins_cross_where_the_table_says():
    """796.8 nm in the table of S. Prahl, as its header's source has it."""
    assert abs(crossing_nm() - 796.8) < 0.1
    assert CROSSES_BETWEEN_NM[0] - 0.5 < crossing_nm() < CROSSES_BETWEEN_NM[1]


def test_the_figure_is_drawn_into_a_folder(tmp_path):
    path = draw_haemoglobins(tmp_path / "new")
    assert path.name == "haemoglobin_fig4.png" and path.stat().st_size > 10_000
