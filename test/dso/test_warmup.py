"""The warm-up reaches every kernel, or says that it did not."""

from ceiling_dso_ros.dso import warmup


def test_it_makes_enough_keyframes():
    assert warmup.warm_up() == warmup.KEYFRAMES


def test_it_says_when_it_did_not(monkeypatch, capsys):
    monkeypatch.setattr(warmup, "warm_up", lambda: 1)
    assert warmup.main() == 1
    assert "not tracked" in capsys.readouterr().err
