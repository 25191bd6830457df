"""The data stage: what it writes, and that nothing is written for bad input."""

import pytest

from racerl.config import compose_settings
from racerl.data.survey import survey
from racerl.documents import read_json
from racerl.errors import LogError, RacerlError, RunError
from racerl.report.log_page import draw_logs
from racerl.run import RunFolder


def settings(*logs, **words):
    words = [f"{key}={value}" for key, value in words.items()]
    return {**compose_settings("data", ["logs=[x]", *words]), "logs": [str(log) for log in logs]}


def test_results_pictures_and_page(driven, tmp_path):
    driven.to_csv(tmp_path / "a<b>.csv", index=False)
    driven.drop(columns=["x", "y", "yaw"]).to_parquet(tmp_path / "b.parquet")
    out = tmp_path / "run"
    facts = survey(settings(tmp_path / "a<b>.csv", tmp_path / "b.parquet"), out)
    assert read_json(out / "data.json") == facts
    assert RunFolder.open_complete(out, "data").manifest["logs"] == 2
    page = draw_logs(out).read_text()
    assert page.count("</figure>") == 6 and "a&lt;b&gt;.csv" in page and "a<b>" not in page and "No trap seen" in page
    svg = (out / "log_0_channels.svg").read_text()
    assert ">speed [m/s]</text>" in svg and ">speed [m/s]</text>" in page
    draw_logs(out)
    assert (out / "log_0_channels.svg").read_text() == svg


@pytest.mark.parametrize("columns", [["v_x"], ["x", "y"], ["current"]])
def test_partial_logs_make_a_page(driven, tmp_path, columns):
    driven.assign(current=1.0)[["t", "run", *columns]].to_csv(tmp_path / "a.csv", index=False)
    survey(settings(tmp_path / "a.csv"), tmp_path / "run")
    assert "<h2>a.csv</h2>" in draw_logs(tmp_path / "run").read_text()


def test_nothing_is_written_for_a_bad_log_and_nothing_written_over(driven, tmp_path):
    (tmp_path / "bad.csv").write_text("t,v_x\n0,a\n1,b\n")
    with pytest.raises(LogError):
        survey(settings(tmp_path / "bad.csv"), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    with pytest.raises(LogError, match="none given"):
        survey(settings(), tmp_path / "run")
    driven.to_csv(tmp_path / "a.csv", index=False)
    survey(settings(tmp_path / "a.csv"), tmp_path / "run")
    with pytest.raises(RunError, match="already holds"):
        survey(settings(tmp_path / "a.csv"), tmp_path / "run")


@pytest.mark.parametrize(
    "name, content", [("data.json", b"{}"), ("log_0.parquet", b"no"), ("data.json", b'{"logs": [1]}')]
)
def test_a_tampered_run_is_one_line(driven, tmp_path, name, content):
    driven.to_csv(tmp_path / "a.csv", index=False)
    survey(settings(tmp_path / "a.csv"), tmp_path / "run")
    (tmp_path / "run" / name).write_bytes(content)
    with pytest.raises(RacerlError) as error:
        draw_logs(tmp_path / "run")
    assert "\n" not in str(error.value)
