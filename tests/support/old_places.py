"""Places as older versions stored them."""

from base64 import b85decode

SECOND_FORM = b85decode(
    b"QdUq?0+s*(0Qdj^0DB^9WqELKX>N3LB04lIB6DeaWg<E_EFyDoVPk1-XCgW<E;uYAb97;DWNB_^B04cMHY_4%a&L8RWFk5_F)Si&Z)9a`B03"
    b"^%A}k_QUu<P|Wo%z_bz*H{a3VTeTQM#$EHExGEHExGEHExGT`XHLE-)-HE-)-GE-)-GE-+mzTQDv#EHExGEHN%HEHExGU0r=BwJ-f(004Cd0"
    b"K^SdXu0RFe9j61|Ni~}{r~^~QKR(#xE8Z8xLXM(=>Px!=l}oz000001^@s6Jpcdz5dZ)HD77#BAY7#Z0Kx?f48R)>Fwcvtv(P|Gjyue^RI2y"
    b"6w<V?ChPreL==LWqDGfJS2eJncFya6&VSsQ>9z_5E5O8n-01Utafx=->=nNJO4unG?u*f_v6$XPr;jp+QJ{byzK_M_`d@%L@|Nr&{0000Z00"
    b"00J9@PK<;(-MU(C6i-0#GV)69`k0)hB=A&vYJC1PW0A0B}=O#RW=GRD~r+P?SIg0Jx$vYB(Tg7M39fhHwVE(Pd_cK{=11Zi#ZDc|zp"
)
"""Forty points facing up at a height of 0.3 m, 30 of them standing, and four keypoints, of the second form."""
