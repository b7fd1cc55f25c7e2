"""Words in column names for a role, another quantity or a setpoint, in common languages.

A word with another meaning in a second language is not in the lists: an unknown word leads to a
question to the user, but a wrong word leads to a wrong role.
"""

import unicodedata
from typing import Final


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
