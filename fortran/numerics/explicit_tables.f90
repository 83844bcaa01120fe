! Optimize: -O2
!> Explicit Runge-Kutta methods, as tables for second-order systems, and Gauss collocations in
!! the same form for trajectories in lanes.
!!
!! For q' = v, v' = f the stages need sums of f only (Nystrom form):
!!   q_i = q_0 + c_i h v_0 + h^2 sum_j (a^2)_ij f_j, v_i = v_0 + h sum_j a_ij f_j,
!! which halves the storage and memory traffic.
!!
!! Coefficients are rounded so that each row still sums to its c and the weights
!! still satisfy the first three quadrature conditions: plain rounding causes an error of 4e-15 in
!! the sum of Verner's weights, whose effect grows with time.
module viscovib_explicit_tables
  use viscovib_exact_products, only: exact_dot
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: gauss_nodes, lagrange, lagrange_factors
  implicit none
  private

  public :: explicit_table_type, is_series, new_explicit_table, series_order

  integer, parameter, public :: max_stages = 16
  character(len=*), parameter, public :: explicit_names(4) = &
    [character(len=8) :: 'rk4', 'dop8', 'verner8', 'verner9']
  !> Methods for many trajectories at once.
  character(len=*), parameter, public :: lane_methods(11) = &
    [character(len=8) :: explicit_names, 'gauss8', 'gauss16', 'taylor8', 'taylor12', 'taylor16', &
     'taylor20', 'taylor24']
  !> The last methods, of these orders, have no tables: see `viscovib_taylor`.
  integer, parameter :: series_orders(5) = [8, 12, 16, 20, 24]
  integer, parameter :: before_series = size(lane_methods) - size(series_orders)
  !> Number of accelerations that predict the next one of a collocation.
  integer, parameter :: most_predicting = 10

  type :: explicit_table_type
    integer :: n_stages = 0, order = 0
    !> Stage times; lower triangle of a; weights.
    real(wp) :: c(max_stages) = 0.0_wp, a(max_stages, max_stages) = 0.0_wp, b(max_stages) = 0.0_wp
    !> The sums of each stage, the last one being the step itself: number of
    !! terms, indices of the accelerations, and their weights in q and in v.
    integer :: n_terms(max_stages + 1) = 0, from(max_stages, max_stages + 1) = 0
    real(wp) :: weights(2, max_stages, max_stages + 1) = 0.0_wp
    !> True if stages depend on each other, so that they are iterated; then the sums of each stage
    !! in the first sweep, over accelerations of previous stages and, with indices above n_stages,
    !! of the last stages of the step before.
    logical :: implicit = .false.
    integer :: n_first = 0, first_from(max_stages, max_stages) = 0
    real(wp) :: first_weights(2, max_stages, max_stages) = 0.0_wp
  end type explicit_table_type

contains

  !> True if a method, by its index in `lane_methods`, is Taylor's.
  pure logical function is_series(method)
    integer, intent(in) :: method
    is_series = method > before_series
  end function is_series

  !> The order of Taylor's method with this index in `lane_methods`.
  pure integer function series_order(method)
    integer, intent(in) :: method
    series_order = series_orders(method - before_series)
  end function series_order

  !> Table of a method by its index in `lane_methods`.
  pure subroutine new_explicit_table(table, method)
    type(explicit_table_type), intent(out) :: table
    integer, intent(in) :: method
    real(wp) :: square(max_stages), one(max_stages), row(max_stages)
    integer :: i, j, n

    select case (method)
    case (1)
      call runge_kutta_4(table)
    case (2)
      call dormand_prince_8(table)
    case (3)
      call verner_8(table)
    case (4)
      call verner_9(table)
    case (5)
      call gauss(table, 8)
      return
    case default
      call gauss(table, 16)
      return
    end select
    n = table%n_stages
    one = 1.0_wp
    square = 0.0_wp
    do i = 1, n
      table%c(i) = exact_dot(table%a(i, :i), one(:i))
      do j = 1, i - 1
        square(j) = exact_dot(table%a(i, j:i), table%a(j:i, j))
      end do
      row = table%a(i, :)
      call list_terms(table, i, square, row)
    end do
    do j = 1, n
      square(j) = exact_dot(table%b(j:n), table%a(j:n, j))
    end do
    call list_terms(table, n + 1, square, table%b)
  end subroutine new_explicit_table

  !> Collocation at s nodes (Hairer, Lubich, Wanner, Geometric Numerical Integration, II.1.3). The
  !! first sweep uses the polynomial through the accelerations just before each node, like Adams
  !! methods; with more than 10 of them it would amplify their rounding errors too much.
  pure subroutine gauss(table, s)
    type(explicit_table_type), intent(inout) :: table
    integer, intent(in) :: s
    real(wp) :: c(s), b(s), points(min(s, most_predicting))
    integer :: i, j, place

    call gauss_nodes(s, c, b)
    table%implicit = .true.
    table%n_stages = s
    table%order = 2*s
    table%c(:s) = c
    table%b(:s) = b
    table%n_terms(:s + 1) = s
    table%n_first = size(points)
    do i = 1, s
      table%from(:s, i) = [(j, j=1, s)]
      table%weights(:, :s, i) = integrals(c, c, b, c(i))
      do j = 1, size(points)
        place = i - 1 - size(points) + j
        points(j) = c(merge(place, place + s, place > 0)) - merge(0.0_wp, 1.0_wp, place > 0)
        table%first_from(j, i) = merge(place, place + 2*s, place > 0)
      end do
      table%first_weights(:, :size(points), i) = integrals(points, c, b, c(i))
    end do
    table%from(:s, s + 1) = table%from(:s, 1)
    table%weights(1, :s, s + 1) = b*(1.0_wp - c)
    table%weights(2, :s, s + 1) = b
  end subroutine gauss

  !> Weights of values at points in the integrals over [0, x] of (x - t) times their polynomial,
  !! and of the polynomial itself; c and b: Gauss rule with as many nodes, exact for them.
  pure function integrals(points, c, b, x) result(weights)
    real(wp), intent(in) :: points(:), c(:), b(:), x
    real(wp) :: weights(2, size(points)), factors(size(points)), values(size(points))
    integer :: q

    weights = 0.0_wp
    factors = lagrange_factors(points)
    do q = 1, size(c)
      values = x*b(q)*lagrange(points, factors, x*c(q))
      weights(1, :) = weights(1, :) + x*(1.0_wp - c(q))*values
      weights(2, :) = weights(2, :) + values
    end do
  end function integrals

  !> Store the nonzero terms.
  pure subroutine list_terms(table, i, in_q, in_v)
    type(explicit_table_type), intent(inout) :: table
    integer, intent(in) :: i
    real(wp), intent(in) :: in_q(max_stages), in_v(max_stages)
    integer :: j, n
    n = 0
    do j = 1, max_stages
      if (abs(in_q(j)) + abs(in_v(j)) <= 0.0_wp) cycle
      n = n + 1
      table%from(n, i) = j
      table%weights(:, n, i) = [in_q(j), in_v(j)]
    end do
    table%n_terms(i) = n
  end subroutine list_terms

  pure subroutine row(table, stage, from, values)
    type(explicit_table_type), intent(inout) :: table
    integer, intent(in) :: stage, from(:)
    real(wp), intent(in) :: values(:)
    table%a(stage, from) = values
  end subroutine row

  pure subroutine finish(table, order, from, values)
    type(explicit_table_type), intent(inout) :: table
    integer, intent(in) :: order, from(:)
    real(wp), intent(in) :: values(:)
    table%order = order
    table%n_stages = maxval(from)
    table%b(from) = values
  end subroutine finish

  !> Kutta 1901: order 4, 4 stages.
  pure subroutine runge_kutta_4(table)
    type(explicit_table_type), intent(inout) :: table
    call row(table, 2, [1], [0.5_wp])
    call row(table, 3, [2], [0.5_wp])
    call row(table, 4, [3], [1.0_wp])
    call finish(table, 4, [1, 2, 3, 4], [0.16666666666666666_wp, 0.3333333333333333_wp, &
             0.3333333333333333_wp, 0.16666666666666666_wp])
  end subroutine runge_kutta_4

  !> Order 8, 12 stages: Hairer, Norsett, Wanner, Solving Ordinary Differential
  !! Equations I, II.5 (the coefficients of their DOP853).
  pure subroutine dormand_prince_8(table)
    type(explicit_table_type), intent(inout) :: table
    call row(table, 2, [1], [0.05260015195876773_wp])
    call row(table, 3, [1, 2], [0.0197250569845379_wp, 0.0591751709536137_wp])
    call row(table, 4, [1, 3], [0.029587585476806844_wp, 0.08876275643042054_wp])
    call row(table, 5, [1, 3, 4], [0.2413651341592667_wp, -0.8845494793282861_wp, &
             0.924834003261792_wp])
    call row(table, 6, [1, 4, 5], [0.037037037037037035_wp, 0.17082860872947386_wp, &
             0.12546768756682242_wp])
    call row(table, 7, [1, 4, 5, 6], [0.037109375_wp, 0.17025221101954405_wp, &
             0.06021653898045596_wp, -0.017578125000000007_wp])
    call row(table, 8, [1, 4, 5, 6, 7], [0.03709200011850479_wp, 0.17038392571223998_wp, &
             0.10726203044637328_wp, -0.015319437748624402_wp, 0.008273789163814006_wp])
    call row(table, 9, [1, 4, 5, 6, 7, 8], [0.624110958716077_wp, -3.3608926294469414_wp, &
             -0.868219346841726_wp, 27.59209969944671_wp, 20.154067550477894_wp, &
             -43.48988418106996_wp])
    call row(table, 10, [1, 4, 5, 6, 7, 8, 9], [0.47766253643826434_wp, -2.4881146199716677_wp, &
             -0.590290826836843_wp, 21.230051448181193_wp, 15.279233632882423_wp, &
             -33.28821096898486_wp, -0.02033120170850583_wp])
    call row(table, 11, [1, 4, 5, 6, 7, 8, 9, 10], [-0.9371424300859884_wp, &
             5.186372428844064_wp, 1.0914373489967295_wp, -8.149787010746927_wp, &
             -18.52006565999696_wp, 22.739487099350505_wp, 2.4936055526796523_wp, &
             -3.0467644718982196_wp])
    call row(table, 12, [1, 4, 5, 6, 7, 8, 9, 10, 11], [2.273310147516538_wp, &
             -10.53449546673725_wp, -2.0008720582248625_wp, -17.9589318631188_wp, &
             27.94888452941996_wp, -2.8589982771350235_wp, -8.87285693353063_wp, &
             12.360567175794303_wp, 0.6433927460157615_wp])
    call finish(table, 8, [1, 6, 7, 8, 9, 10, 11, 12], [0.054293734116569105_wp, &
             4.450312892752409_wp, 1.8915178993145003_wp, -5.801203960010585_wp, &
             0.3111643669578199_wp, -0.15216094966251656_wp, 0.20136540080403034_wp, &
             0.04471061572777266_wp])
  end subroutine dormand_prince_8

  !> Order 8, 12 stages: the propagating member of the most efficient 8(7) pair of
  !! Verner, Numerical Algorithms 53 (2010) 383.
  pure subroutine verner_8(table)
    type(explicit_table_type), intent(inout) :: table
    call row(table, 2, [1], [0.05_wp])
    call row(table, 3, [1, 2], [-0.006993164062500001_wp, 0.1135556640625_wp])
    call row(table, 4, [1, 3], [0.0399609375_wp, 0.1198828125_wp])
    call row(table, 5, [1, 3, 4], [0.36139756280045765_wp, -1.3415240667004928_wp, &
             1.3701265039000352_wp])
    call row(table, 6, [1, 4, 5], [0.049047202797202816_wp, 0.23509720422144048_wp, &
             0.18085559298135673_wp])
    call row(table, 7, [1, 4, 5, 6], [0.06169289044289044_wp, 0.11236568314640277_wp, &
             -0.03885046071451367_wp, 0.019791887125220453_wp])
    call row(table, 8, [1, 4, 5, 6, 7], [-1.7676302402223292_wp, -62.5_wp, &
             -6.061889377376669_wp, 5.6508231982227635_wp, 65.62169641937624_wp])
    call row(table, 9, [1, 4, 5, 6, 7, 8], [-1.1809450665549708_wp, -41.50473441114321_wp, &
             -4.434438319103725_wp, 4.260408188586133_wp, 43.75364022446172_wp, &
             0.007871425489911044_wp])
    call row(table, 10, [1, 4, 5, 6, 7, 8, 9], [-1.2814059994414884_wp, -45.047139960139866_wp, &
             -4.731362069449577_wp, 4.514967016593808_wp, 47.44909557172985_wp, &
             0.010592282971116612_wp, -0.005746842263842394_wp])
    call row(table, 11, [1, 4, 5, 6, 7, 8, 9, 10], [-1.7244701342624853_wp, &
             -60.92349008483054_wp, -5.951518376222393_wp, 5.556523730698456_wp, &
             63.98301198033305_wp, 0.014642028250415856_wp, 0.06460408772358203_wp, &
             -0.0793032316900888_wp])
    call row(table, 12, [1, 4, 5, 6, 7, 8, 9, 10, 11], [-3.301622667747072_wp, &
             -118.01127235975251_wp, -10.141422388456112_wp, 9.139311332232058_wp, &
             123.37594282840426_wp, 4.62324437887458_wp, -3.3832777380682018_wp, &
             4.527592100324618_wp, -5.828495485811623_wp])
    call finish(table, 8, [1, 6, 7, 8, 9, 10, 11, 12], [0.04427989419009185_wp, &
             0.3541049391724449_wp, 0.24796921549562606_wp, -15.694202038838084_wp, &
             25.084064965558564_wp, -31.738367786260277_wp, 22.938283273988784_wp, &
             -0.23613246330715074_wp])
  end subroutine verner_8

  !> Order 9, 15 stages: the propagating member of the most efficient 9(8) pair of
  !! Verner, as above.
  pure subroutine verner_9(table)
    type(explicit_table_type), intent(inout) :: table
    call row(table, 2, [1], [0.03462_wp])
    call row(table, 3, [1, 2], [-0.03893354388572874_wp, 0.13595789452450918_wp])
    call row(table, 4, [1, 3], [0.036384131489542684_wp, 0.109152394468628_wp])
    call row(table, 5, [1, 3, 4], [2.02576391439397_wp, -7.638023836496292_wp, &
             6.173259922102322_wp])
    call row(table, 6, [1, 4, 5], [0.05112275589406061_wp, 0.17708237945550215_wp, &
             0.0008027762409222455_wp])
    call row(table, 7, [1, 4, 5, 6], [0.13160063579752163_wp, -0.29572762526696367_wp, &
             0.0878137803564295_wp, 0.6213052975225275_wp])
    call row(table, 8, [1, 6, 7], [0.07166666666666668_wp, 0.33055335789153195_wp, &
             0.24277997544180138_wp])
    call row(table, 9, [1, 6, 7, 8], [0.071806640625_wp, 0.3294380283228177_wp, &
             0.11651900292718229_wp, -0.034013671874999984_wp])
    call row(table, 10, [1, 6, 7, 8, 9], [0.04836757646340647_wp, 0.03928989925676164_wp, &
             0.10547409458903446_wp, -0.02143865284648313_wp, -0.10412291746271944_wp])
    call row(table, 11, [1, 6, 7, 8, 9, 10], [-0.02664561487201479_wp, 0.03333333333333333_wp, &
             -0.1631072244872467_wp, 0.033960816841277615_wp, 0.1572319413814626_wp, &
             0.21522674780318796_wp])
    call row(table, 12, [1, 6, 7, 8, 9, 10, 11], [0.03689009248708622_wp, &
             -0.1465181576725543_wp, 0.2242577768172024_wp, 0.02294405717066073_wp, &
             -0.0035850052905729048_wp, 0.08669223316444385_wp, 0.43838406519683376_wp])
    call row(table, 13, [1, 6, 7, 8, 9, 10, 11, 12], [-0.4866012215113341_wp, &
             -6.304602650282853_wp, -0.2812456182894726_wp, -2.679019236219849_wp, &
             0.5188156639241577_wp, 1.3653531876033418_wp, 5.8850910885039465_wp, &
             2.8028087862720628_wp])
    call row(table, 14, [1, 6, 7, 8, 9, 10, 11, 12, 13], [0.4185367457753472_wp, &
             6.724547581906459_wp, -0.42544428016461133_wp, 3.3432791530012653_wp, &
             0.6170816631175374_wp, -0.9299661239399329_wp, -6.099948804751011_wp, &
             -3.002206187889399_wp, 0.2553202529443442_wp])
    call row(table, 15, [1, 6, 7, 8, 9, 10, 11, 12, 13, 14], [-0.7793740861228848_wp, &
             -13.937342538107776_wp, 1.2520488533793563_wp, -14.691500408016868_wp, &
             -0.494705058533141_wp, 2.2429749091462368_wp, 13.367893803828643_wp, &
             14.396650486650687_wp, -0.79758133317768_wp, 0.44093537095342766_wp])
    call finish(table, 9, [1, 8, 9, 10, 11, 12, 13, 14, 15], [0.014611976858423092_wp, &
             -0.3915211862331339_wp, 0.23109325002895065_wp, 0.12747667699928525_wp, &
             0.2246434176204158_wp, 0.5684352689748513_wp, 0.05825871557215772_wp, &
             0.13643174034822156_wp, 0.030570139830828565_wp])
  end subroutine verner_9

end module viscovib_explicit_tables
