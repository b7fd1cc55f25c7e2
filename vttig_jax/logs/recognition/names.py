"""Meaning of a column name: its role, unit, another quantity, or a setpoint, in common languages.

A word with another meaning in a second language is not in the lists: an unknown word leads to a
question to the user, but a wrong word leads to a wrong role.
"""

import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from ..readers.column_names import ANGLES, OTHER_UNITS, TIME_UNITS, bracket_of, name_and_unit


def fold(text: str) -> str:
    """Return a text in lower case without accents."""
    decomposed = unicodedata.normalize("NFKD", text.casefold())
    plain = "".join(letter for letter in decomposed if not unicodedata.combining(letter))
    return unicodedata.normalize("NFC", plain)  # joins Korean syllables again


def _words(text: str) -> frozenset[str]:
    """Return the words of a text in lower case without accents."""
    return frozenset(fold(text).split())


DRIVING: Final = _words(
    """
    driving drive driver drv motor mot servo input inp inputshaft antrieb antriebs eingang
    eingangs ingang ingaand ingaande aandrijving aandrijf ingaende indgang inngang drivande
    drivende moottori tulo
    moteur entree menant menante motore ingresso entrata motrice entrada motriz conductor
    conduttore motora
    silnik silnika wejscie wejscia napedowe napedowy vstup hnaci giris motoru
    вход входа ведущий двигатель двигателя мотор мотора
    电机 电动机 馬達 输入 輸入 主动 主動 驱动 驅動 入力 駆動 モータ モーター 입력 모터 구동
    """
)
"""Words for the driving shaft."""

DRIVEN: Final = _words(
    """
    driven load output outp outputshaft abtrieb abtriebs ausgang ausgangs last lastseite
    lastwinkel lastposition lastgeber uitgang uitgaand uitgaande aangedreven belasting utgang
    utgaende udgang drivna drivet drevet lahto kuorma
    sortie mene menee charge recepteur uscita condotto carico salida conducido carga saida movida
    conduzida
    wyjscie wyjscia napedzane napedzany obciazenie obciazenia vystup hnany zatez cikis yuk
    выход выхода ведомый нагрузка нагрузки
    负载 負載 负荷 负荷 输出 輸出 从动 從動 被动 被動 被驱动 出力 負荷 従動 被駆動 출력 부하
    """
)
"""Words for the driven shaft."""

OUTPUT_SIDE: Final = _words("joint link arm axis secondary")
"""Words for the driven shaft where no other name says it: `axis 1 motor` is the driving shaft."""

TIME: Final = _words(
    """
    time t elapsed uptime zeit zeitpunkt laufzeit messzeit
    timestamp stamp timestamps zeitstempel datetime date datum uhrzeit clock
    epoch utc datenum tijd tid tidpunkt aika temps horodatage tempo tiempo fecha hora heure czas
    cas время zaman 时间 時間 時刻 时刻 시간
    """
)
"""Words for time."""

QUANTITIES: Final = _words(
    """
    speed velocity vel rpm omega otacky turtall geschwindigkeit drehzahl vitesse velocidad velocita
    velocidade hastighet hastighed snelheid toerental predkosc rychlost nopeus скорость hiz
    速度 转速 轉速 回転数 속도 acceleration accel acc beschleunigung versnelling
    torque moment drehmoment couple coppia koppel vridmoment torsion par torsor 扭矩 转矩
    トルク current cur curr strom courant corriente corrente stroom iq id amps ampere 电流 電流
    temp temperature temperatur temperatuur temperatura 温度 voltage volt volts spannung tension
    spanning power leistung puissance force kraft pressure druck error err fehler deviation
    abweichung lag schleppfehler status state zustand flag flags mode modus alarm enable enabled
    fault index idx row zeile sample samples humidity noise per dps rps nm mm um
    v n w velo cell file kn kg ma mv kv kw bar hz khz degc voltaje tensione intensite courants
    proud napeti prad
    napiecie varvtal spanningen leistung vermogen puissance potencia potenza teplota temp момент
    температура ток мощность напряжение sicaklik tork akim 토크 온도 전류 전압 電流 電圧 功率
    elec electrical elektrisch electrique electrico elettrico
    vibration vib pwm duty gain checksum crc sequence seq utilization percent
    """
)
"""Words for quantities other than the angle of a shaft."""

SETPOINTS: Final = _words(
    """
    set setpoint setp sp soll sollwert solllage sollposition target tgt command commanded cmd
    demand demanded ref reference desired des nominal consigne consigna riferimento ziel
    leitwert zadana zadany referencia gewenst gewenste borvarde cible objetivo
    obiettivo hedef уставка wanted setvalue
    profile trajectory trajektorie planned virtual 指令 目标 目標 задание 목표 지령
    expected expect ideal theoretical theory predicted prediction modelled modeled simulated
    calculated calc computed erwartet erwartung berechnet theoretisch vorhergesagt simuliert
    attendu calcule theorique previsto calcolato teorico esperado calculado berekend verwacht
    """
)
"""Words for a setpoint or for a computed angle; neither is a measured one."""

COMPOUND: Final = 5
"""Least number of letters of a word that is also searched inside a longer word, such as `drehzahl`
in `motordrehzahl`; a word for a role must be at the start or end of the longer word (chosen)."""

SHORT: Final = 4
"""Least number of letters of a word for another quantity that is joined to a word for a shaft, such
as `temp` in `motortemp` (chosen)."""

_ROLE_WORDS = {"driving": DRIVING, "driven": DRIVEN, "time": TIME}
_KNOWN = {word: role for role, words in _ROLE_WORDS.items() for word in words}
_LONGEST_FIRST = sorted((one for one in DRIVING | DRIVEN if len(one) >= SHORT), key=len)[::-1]
_PARTS = re.compile(r"[/\\.:]+")
_CAMEL = re.compile(r"(?<=[a-zß-ÿ0-9])(?=[A-ZÀ-Þ])|(?<=[A-Z])(?=[A-Z][a-z])")
_WORDS = re.compile(r"[^\W\d_]+")
_WIDE = re.compile(r"[\u1100-\u11ff\u2e80-\uffef]")


@dataclass(frozen=True)
class NameReading:
    """Meaning of one column name.

    **Arguments**
    - `role`: "driving", "driven" or "time", or None if the name contains none or two of them.
    - `unit`: unit of an angle or of time in the name, or None.
    - `other`: word or unit in the name for a quantity other than angle and time, "" if none.
    - `setpoint`: word for a setpoint in the name, "" if there is none.
    - `output_side`: whether a name without a role has a word such as `joint`.
    """

    role: str | None
    unit: str | None
    other: str
    setpoint: str
    output_side: bool = False

    @property
    def is_angle(self) -> bool:
        """Whether the name allows that the column is the angle of a shaft."""
        return self.role != "time" and not self.other and self.unit not in TIME_UNITS


def read_name(name: str, where: str, units: Sequence[str] = ANGLES) -> NameReading:
    """Return role, unit, other quantity and setpoint that the name of a column contains.

    Slashes, dots and colons divide a name into parts, as in `rec/motor.pos`. The role comes from
    the last part, or from the whole name if the last part has no role. A name with two different
    roles gets no role. `where` names file and column in error messages; `units` are those of a
    shaft.

    **Raises** `LogError` if the name has two different units.
    """
    stem, unit = name_and_unit(name, (*units, *TIME_UNITS), where)
    inside = bracket_of(name)
    other = inside if unit is None and inside in OTHER_UNITS else ""
    last = [part for part in _PARTS.split(stem) if part.strip()][-1:]
    words = words_of("".join(last))
    quantities = _found(words, QUANTITIES)
    role = _role(words) or _role(words_of(stem))
    if unit in TIME_UNITS and role in ("driving", "driven"):
        role = None
    every = words_of(stem)
    setpoint = _found(every, SETPOINTS)
    output_side = role is None and not OUTPUT_SIDE.isdisjoint(every)
    return NameReading(role, unit, other or quantities, setpoint, output_side)


def words_of(text: str) -> list[str]:
    """Return the words of a name in lower case; `MotorPos_deg` gives motor, pos and deg."""
    return [fold(word) for word in _WORDS.findall(_CAMEL.sub(" ", text))]


def inputs_and_outputs(names: Sequence[str]) -> dict[int, str]:
    """Return index → role for names that differ only by `in` (driving) and `out` (driven)."""
    words = [words_of(name) for name in names]
    roles: dict[int, str] = {}
    for k, own in enumerate(words):
        if own.count("in") != 1:
            continue
        twin = ["out" if word == "in" else word for word in own]
        if words.count(own) == 1 and words.count(twin) == 1:
            roles |= {k: "driving", words.index(twin): "driven"}
    return roles


def _role(words: Iterable[str]) -> str | None:
    """Return the role of the words, or None if they have no role or several roles."""
    roles = {role for word in words for role in _roles_of(word)}
    return roles.pop() if len(roles) == 1 else None


def _roles_of(word: str) -> set[str]:
    """Return the roles of one word, from the known words that it contains.

    A longer known word has priority over a shorter one that is a part of it.
    """
    if word in _KNOWN:
        return {_KNOWN[word]}
    wide = bool(_WIDE.search(word))
    found = [
        known
        for known in _KNOWN
        if (wide and _WIDE.search(known) and known in word)
        or (not wide and len(known) >= COMPOUND and _is_part(known, word))
    ]
    roles = set()
    for known in sorted(found, key=len, reverse=True):
        if known in word:
            roles.add(_KNOWN[known])
            word = word.replace(known, " ")  # 被駆動 contains 駆動, which means the opposite
    return roles


def _is_part(known: str, word: str) -> bool:
    return _KNOWN[known] != "time" and (word.startswith(known) or word.endswith(known))


def _found(words: Iterable[str], known: frozenset[str]) -> str:
    """Return the first of `words` that is in `known` or contains a word of `known`, or ""."""
    for word in words:
        if word in known or any(_holds(word, one) for one in known):
            return word
    return ""


def _holds(word: str, known: str) -> bool:
    """Return whether `word` is a compound that contains the known word `known`.

    A short known word counts only next to a word for a shaft: `motortemp`, but not `temps`.
    """
    if known not in word:
        return False
    if _WIDE.search(known) or len(known) >= COMPOUND:
        return True
    shafts = (one for one in _LONGEST_FIRST if word.startswith(one) or word.endswith(one))
    shaft = next(shafts, "")
    if not shaft or len(known) < SHORT:
        return False
    rest = word.replace(shaft, "")
    starts = rest.startswith(known) or rest.startswith(f"s{known}")  # Antriebssoll has an s between
    return starts or rest.endswith(known)
