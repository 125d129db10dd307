"""Places as versions stored them, for those after them to read."""

from base64 import b85decode

SECOND_FORM = b85decode(
    b"QdUq?0+s*(0Qdj^0DB^9WqELKX>N3LB04lIB6DeaWg<E_EFyDoVPk1-XCgW<E;uYAb97;DWNB_^B04cMHY_4%a&L8RWFk5_F)Si&Z)9a`B03"
    b"^%A}k_QUu<P|Wo%z_bz*H{a3VTeTQM#$EHExGEHExGEHExGT`XHLE-)-HE-)-GE-)-GE-+mzTQDv#EHExGEHN%HEHExGU0r=BwJ-f(004Cd0"
    b"K^SdXu0RFe9j61|Ni~}{r~^~QKR(#xE8Z8xLXM(=>Px!=l}oz000001^@s6Jpcdz5dZ)HD77#BAY7#Z0Kx?f48R)>Fwcvtv(P|Gjyue^RI2y"
    b"6w<V?ChPreL==LWqDGfJS2eJncFya6&VSsQ>9z_5E5O8n-01Utafx=->=nNJO4unG?u*f_v6$XPr;jp+QJ{byzK_M_`d@%L@|Nr&{0000Z00"
    b"00J9@PK<;(-MU(C6i-0#GV)69`k0)hB=A&vYJC1PW0A0B}=O#RW=GRD~r+P?SIg0Jx$vYB(Tg7M39fhHwVE(Pd_cK{=11Zi#ZDc|zp"
)
"""Forty points facing up at a height of 0.3 m, 30 of them standing, and four keypoints, of the second form."""

THIRD_FORM = b85decode(
    b"QdUq?155w_0Qdj^0DB^9WqELKX>N3LB04lIB6DeaWg<E_EFyDoVPk1-XCgW<E;uYAb7f<6X>V?GB05_!EHN-SEHN@SEHpS>EFx`hWMyn3IwE"
    b"Z%eJHgr{a}3nbq4^%4FCY}KLG!^{(Sxc015zr00965uM4Tb0Y}gRjz(rgTt(zwM=^i^0-~Y}$E@i8=l=iz1^@vb0000HvY+Pq+q%@^b$ik3e"
    b"9N}3#^115!|aUTSgR;)C3t@3XP&#ovfzk6h9GlW%SmvwgWEbSIM)~TO``-q7r+i*|3q?<6e=57x=ORW#?ckQRWJLLkC?}|n=^hzKI@-4>tO5"
    b"{AWEV;o~tld?{e#@OZETu{{R35)Bp+q000kzxFNql9w%tl*f1u?BjK7TM*c1KOAh4AV)c3ILBf4Kn+5>8K!5~;i~Oac0Q?9577IGo!Yd-D7I"
    b"~ON(0*6{?E"
)
"""The same place in the form of today: it must be read by every later version."""
