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
"""The same place in the third form."""

FOURTH_FORM = b85decode(
    b"QdUq?1Ynw(nVFfH=|2Pj000Oi0001g00001Z2$lO00000000000000000030x&D0q0RReIAbjq`Jm%JCFY17T$cQUL^61RqJJ#7N&AuSV=>O;c000I60"
    b"UiJV01>jE=K9;Z)Z%q}(dvB5wywtCuvo+FjNe$RC~YNpe&%PMyT!8Lh(CrPb6d+vaI}NlIxRTY7xhh}1V0zR4qyL7a*`A(8(6wZv%JR96~R?6`;?EE$G"
    b"4j^enmd(pE~Pc>=+<QqC1|eFjwz#>#0li|Mvd?00q<l3IG5A4}-WNzd#-*Xx7*;CdVV;nkYv8E%r+e<jZ39dFnyJeLb6?xmOxATo2)<j@jL=eksK"
)
"""The same place in the form of today: it must be read by every later version."""

THIRD_FORM_OF_A_YARD = b85decode(
    b"QdUq?16}|C0H_220DB^9WqELKX>N3LB04rOEFyDhdSxOyGcqh9b8ul}X>MmCIxsFcEFyDdV{~b6ZgV0!TQn>+FgPqVFg7ePG&o%>B5iMEWo#lkA~`THG"
    b"h{MmG&wdlH)UitG9rB_wJ-f(?gRBC05nMe0PsHmEt<vTYW{Zq1ONyCyYBD1R_$+lxt%m15Gj}hF^=Bxs;c||KGZ~kj;8=jU8n?xsk8))SZ%lvkQgA9Zo"
    b"bCcEzbJ@HooXQS!igaRAsn~rKEzsy1h2Ky)ps=IsyW^!UD$WG6Dk1&px{D2R^>~&f7k|{=UBdJ_ZH?!!`l}#s&h$(>~V%&ebOB?JnG8=D);TAqzv#-U^"
    b"mi!Dt0?&BkBV*ThPX(o|K?3K7q+;Kf4DYydl(*i<d>hzp<~1VZ5xdqC{tG7;p+Lm{ArLLLl+gsg8fg2=D~upk9O-)w}0BqSnIE>HYUK|qWgiRXf5giL7"
    b"f;S-jLfB+YEmBjqKx>5)NH6h~9tsr4~MC6nK1UGpDx7ypS0Du4h058PsoDdT3!gvP4#^<o$=lNmtcR1w0Kmb5MR^R{J0FW@M)9%iEPF-*k$M*m_0w89y"
    b"03ZAS137hI4)H>$fr<SPQ<bt_WC_DAQjvg*s>tsEIH(4P{msrW00_<RN>~DYv;i5V8UFj-0#v1ASvt#s1sHTyk(6l^?g1JAR_dq_0<!=`GXa1?NB{vj{"
    b"1|6^QlrQBfa(!TtD))yce36kg}_^0^%Frpc%~W<BME?n4gLTC5wDFL?YIY?3V56%by8k05gLl0%R-m{08yA{u66-lRR9112mmrT%>T{*{{IA&0Pp|+01"
    b"+7od&EsP5y-VX2Qq9|J=jXUArCSt)0N@b4>(P~k6`vzd5pI{SwTuUlH|Hk2m%~9-E^;j23hMy2NAiaXj8B;-S81XCBKOj$J)QT-x-8)e_Eu(gt&#9esN"
    b"hPbujR)^S3e0WDt>2jBCUQ6T0a(71s|Notd22!?bu8TI)N%qQ707X+O|XVo{c9vB(f!Mi}%%ke{@;lfPaE=Nv$n;PkN>i`Y1Z;eLyiQFai+j@527>p3b"
    b";%UBqZRYx=rtc_UagmNCFuI+(2oj|Pl8q~m+XbEFIkWwQ_2VR8BHEP=knTgtkBIE{ug+EU5JBrtBvC^t9!WnhItCS=^OnTo#x&Jl=43lZC?F*Ek`a+sQ"
    b"3*1uF9p?ZB$PDlvW`FCB52TEEZ=fjz6nP-p3!A&!(DynfK*stmx@yrGFUCWW)Xt`e3x-XQDl#tTFf;kux{im1__)05Lv!cGj5vs<wDCzE+0va|j1B_v="
    b"(h7C&Rm&}6jH>HxQm6gjnOA5E}5aJ<-45L@2s29Xo7DNr#Ex0PNy7M)C~0nwlq%4U67ndmSOvihZ@TX`B-us7GbrB0Q%}7PE{ly`RQ8Z=d}7OW_V)He("
    b"x@Qn5a(xur)LX_i-9WPO;%Rel9pWNG<Yc835$}<p2Nw1wsH&0000aj{Abh&snR=!x!5JGGJeSd6Nqj)uK1rv$E2E+(u#v2b}mM8h<ZHeSIAP0OxWmqpc"
    b"LRguME_w`??38#p1TQMx<R!Z-Jb@qh-PESCEC5!x|zJ6?qWLxu906aO!iR0IZ6lFXDDFOQI!$cf$M|4?KUl15!&frBPcI5C7QS<br?)BghiFBJjcM*y%"
    b"myr%w1;~1KAwBVaVQ|Ji"
)
"""Sixty keypoints, 240 standing and 80 ground points of `tests.support.yards.yard(1)`, of the third form."""
