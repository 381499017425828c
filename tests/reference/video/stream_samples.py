"""H.264 and H.265 of 64 x 48 px, a key frame every six pictures; the left half of picture k is 10 k + 20."""

from base64 import b85decode

H264 = [
    b85decode(
        "00001XJh~htg;C7AOHXZ03ZMW1p(qj$p8QV0ch*P%Ob!40004Hh=dCN{@Ca9EUG*#&^1)JkN_z5L~YeULbSItnn97eEl-"
        "Mi&sb%Bk*fs>Bz}}MQHZZQyy`s"
    ),
    b85decode("00001L7F=duZN?5|BfpaD`hZZ!{J`LFqUutghJ2@4L+6Oq-%-Nb3w24gQI`=$FLt0Cm6(?s)TOf"),
    b85decode("00001L7GnpWXfR*|ABG8|Hnm&mPMFo;)O3;bT8YUU`ig^&4{k21U>N"),
    b85decode("00001L7H-SL&=oDg@1u@zyHS-ij}gMF=6npV_H-fj3v%?nsc*76CJ<"),
    b85decode("00001L7I|yL&=oDg@1u@zyHTYik3x~XyS!0TXZjD@QFkm?9o7raR"),
    b85decode("00001L7K97L&=oDg@3!hz@x3V|KbZO@s`=0ZYde}%{fV%!C0SN!2"),
    b85decode(
        "00001XJh~htg;C7AOHXZ03ZMW1p(qj$p8QV0ch*P%Ob!40004Hh=K!u{^0}o6wZN()+)kWl|tso?Sq7GH#ns9Uo!wJH4YZv^*Zot"
        "TsP|>eCBTurKy~z^Q?i7as9FR"
    ),
    b85decode("00001L7F=due^uyu<!rz`H6av&edZamw8@xH<Pxjsr?r"),
    b85decode("00001L7GnpWXfR*|GbCtu<!rz_z8ND&edZamu^srjIu|UmT0{Q"),
    b85decode("00001L7H-SL&=oDg@3$<^04p!@$seVLpxQBa$UJXCNjw$c)Q>"),
    b85decode("00001L7I|yL&=oDg@3$<^04p!@zP$TGqqU9CEJuFz~#jtJ@E"),
    b85decode("00001L7K97L&=oDg@3-x6S)>bj#j1dTCCDMFG8^q7r+"),
    b85decode(
        "00001XJh~htg;C7AOHXZ03ZMW1p(qj$p8QV0ch*P%Ob!40004Hh=dLQ{^0}o6loN7im;a@Py#+E5su1ajpe>dH>A^x5uuk735k3{"
        "6vjP~8ZMFJ{^B@b"
    ),
    b85decode("00001L7F=due^uyu<!rz@CE8aI_F_51OSx0APWmPEvoHLI9U+N@)Q4a_MA|*SE;Wq`+)"),
]
H264B = [
    b85decode(
        "00001XJh~htl30*5C8xJ01yBG0|J2YB3WPn0004K>*LEJzyJUM0cD7U05AXk+gtN2t8d%HZA%=Ezz7_STFXV%mA03~<1`4n7|jv?"
        "{;Jdbqq)+G#N*k$xV-"
    ),
    b85decode("00001L7F3MLjS)v`Io2v`2M9ZtcQm;e@p5BZsDm47eD~b!~wKWG4g?pY`qj3(iJ5C!?Je!h5i;cH%#^IO}8ER"),
    b85decode("00001L7qW)h5v%kXvfnHKL"),
    b85decode("000010iI%NLcfk^3<}~($#4"),
    b85decode("00001L7HYss6l9%ObA#1yod6z@Bi`pDSD93xKt_4$l0eUA1x-b*c}oU;Q"),
    b85decode("00001L7s#~5iBqNhQ-?fyYOK"),
    b85decode("000010iLC5Lcfi61)p;("),
    b85decode("00001L7JyYs6lL*ObA#1yod6z@Bi`niF%OE)ngo&ZcvGgvPYMknO^"),
]
H265 = [
    b85decode(
        "00001KmiN^|NjAC00093kN^M!000939+H5N00001LID8*U;qFE0FVFx0{{R603M(qgBDpT<jUrNfB*mk0Du4h3IqTE00Be+!E?}w"
        "00001C;_h>fbb3o|MEKg&omqBtp8?ES*k~B^?A~Wb@{C1"
    ),
    b85decode("000010s+toeh|hx=#E#XJ79tYzvLd=PGk3_=9^h4XAwGs(F22k"),
    b85decode("000010s+tw|I|YUIp~g8t6PH%VxYdUHFp"),
    b85decode("000010s+t%pZ&xz806@VSEoBalf9kU@qh"),
    b85decode("000010s+t<pZ&xz80_edSF1NyEN18"),
    b85decode("000010s+t{pZ&xz806@VSF1NyEN18"),
    b85decode(
        "00001KmiN^|NjAC00093kN^M!000939+H5N00001LID8*U;qFE0FVFx0{{R603M(qgBDpT<jUrNfB*mk0Du4h3IqTE00Be+!E?}w"
        "00001Dgmq*O<Y#*)Ghzvi|9_XerCfteNR9CpKg(TZbI@cP?uFWUG&~A`dVX8^leqHy6Fa1rD0kz#N)K0e1mmB|Gw+l8;xX^3C}8k"
    ),
    b85decode("000010s+uDeh|hv=#E#a%Gt)(2vN@"),
    b85decode("000010s+uL|I|YUIp~g8rx#Z&fd-c"),
    b85decode("000010s+uSpZ&xz80_edSF1NyEN18"),
    b85decode("000010s+uapZ&xz806@VSF1NyEN18"),
    b85decode("000010s+uipZ&xz80_^i^9u6R=QnT"),
    b85decode(
        "00001KmiN^|NjAC00093kN^M!000939+H5N00001LID8*U;qFE0FVFx0{{R603M(qgBDpT<jUrNfB*mk0Du4h3IqTE00Be+!E?}w"
        "00001Dgmr8O<Y3in7>MUTUG*~)j!+T*S`B(8~Zq;0ijjd`~"
    ),
    b85decode("000010s+uzeh|hv^)d4eXFI$pNxI#rCI1^!6CZU}Y}ID~L&fXwUr+"),
]
H265B = [
    b85decode(
        "00001KmiN^|NjAC00093kN^M!000939+i*@00001LID8*U;qFE0FVFx0{{R603M(qgBDp?E=;ay2mk;B00;m80|1~v00001L;=Bb"
        "(1`#500AfguN{E!4haA9I{fhHHlmsSrAa**#;tTMM%J1v{rC"
    ),
    b85decode("000010s+t&UxYD^K<JKFxsAAw;RE2P69070c#LTK8a50k(mUQT!teFSOYD=Q1Z-U}RGCPm"),
    b85decode("000010s-Jem*IpE0FyKypC+3Cjj1#"),
    b85decode("0000100H16|N1N?fB=J4LlD3"),
    b85decode("000010s+u4m)G1w0gk}vj#s(Qt-=}eI|$SOwJ-dB@B"),
    b85decode("000010s-KnCD->DK>(9A>qs<X>N@"),
    b85decode("0000100H2J|NSDuSe}4z"),
    b85decode("000010s+uCzhB%#0ggcEj#sNuQmYRv@6-"),
]
