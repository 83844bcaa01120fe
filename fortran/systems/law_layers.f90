! Optimize: -O2
!> Detects thin layers of force laws, in which the operand of an instruction changes too fast for a
!! polynomial through the nodes of a step.
!!
!! In tanh(v/1e-4) or exp(-(x/1e-3)^2) the force changes within a layer that a step may skip. A bump
!! may lie between all nodes of a step and of its halves, so comparing runs does not detect it. The
!! operands are smooth and well resolved. Consider a function whose nearest singularity is at the
!! distance D from the values of its operand in a step, which span L. The error of polynomial
!! interpolation decreases per degree by the factor
!!
!!   r = 2 D/L + sqrt((2 D/L)^2 + 1)  (near the values),  1 + 2 D/L + sqrt((1 + 2 D/L)^2 - 1)
!!
!! (on the real axis), the parameter of Bernstein's ellipse: L N. Trefethen, Approximation Theory
!! and Approximation Practice, 2013, chapter 8.
module viscovib_law_layers
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_branches, only: signal_type
  use viscovib_law_functions, only: divide, f_acos, f_acosh, f_asin, f_asinh, f_atan, f_atan2, &
                                    f_atanh, f_cos, f_cosh, f_exp, f_log, f_sin, f_sinh, f_sqrt, &
                                    f_tan, f_tanh, is_whole, known_power, operands, put_number
  use viscovib_law_roots, only: find_roots
  use viscovib_law_term, only: law_term
  implicit none
  private

  public :: law_layers

  !> Largest permitted thinness. Nodes are at most a fifth of a step apart, so some lie within such
  !! a layer. For steps with fewer than 8 nodes the limit is `unseen_by_node` per node.
  real(wp), parameter, public :: unseen = 20.0_wp, unseen_by_node = 2.5_wp

  !> An instruction and its operand, whose values must be resolved.
  type :: layer_type
    integer :: code = 0
    type(signal_type) :: operand
  end type layer_type

  !> Layers of all laws of a system.
  type :: law_layers
    type(layer_type), allocatable, private :: layers(:)
  contains
    procedure :: find
    procedure :: exist
    procedure :: followed
    procedure :: thinness_at
  end type law_layers

  !> Resolved change of an operand in a step, as a fraction of the distance to singularities off the
  !! real axis (r = 4.9) and on it (r = 5.8), and for functions without singularities.
  real(wp), parameter :: nearby = 0.85_wp, ahead = 1.0_wp, none = 6.0_wp
  !> For operands beyond these, tanh is 1 and exp is 0 to rounding.
  real(wp), parameter :: flat = 20.0_wp, nothing = -50.0_wp
  !> Possible excess of an operand over its sampled range (interpolation error), relative to the
  !! range; smallest distance to a singularity, relative to the sampled distance.
  real(wp), parameter :: doubt = 0.05_wp, closest = 1.0e-6_wp
  real(wp), parameter :: half_pi = 1.5707963267948966_wp

contains

  !> Find the layers of all laws without internal state; other transitions are surfaces.
  subroutine find(self, laws)
    class(law_layers), intent(out) :: self
    type(law_term), intent(in) :: laws(:)
    type(layer_type), allocatable :: layers(:)
    integer :: i
    allocate (self%layers(0))
    do i = 1, size(laws)
      if (laws(i)%state > 0) cycle
      call find_layers(laws(i), layers)
      self%layers = [self%layers, layers]
    end do
  end subroutine find

  !> True if there are layers.
  pure logical function exist(self)
    class(law_layers), intent(in) :: self
    exist = .false.
    if (allocated(self%layers)) exist = size(self%layers) > 0
  end function exist

  !> Largest thinness of all layers (see `thinness`).
  real(wp) function thinness_at(self, t, places, q, v, apart, enough)
    class(law_layers), intent(in) :: self
    !> As for `thinness`.
    real(wp), intent(in) :: t(:), places(:), q(:, :), v(:, :)
    logical, intent(in) :: apart
    !> Only values above this limit need to be exact; default: `unseen`.
    real(wp), intent(in), optional :: enough
    real(wp) :: most
    integer :: i
    most = unseen
    if (present(enough)) most = enough
    thinness_at = 0.0_wp
    do i = 1, size(self%layers)
      thinness_at = max(thinness_at, thinness(self%layers(i), t, places, q, v, apart, most))
    end do
  end function thinness_at

  !> Vector lanes in which the range of all states is so small that single steps need no check.
  function followed(self, n, t, q, v, most) result(lanes)
    class(law_layers), intent(in) :: self
    !> States per lane; times and states of all lanes, lane first; limit as for `thinness`.
    integer, intent(in) :: n
    real(wp), intent(in) :: t(n_lanes*n), q(:, :), v(:, :), most
    logical :: lanes(n_lanes)
    real(wp) :: z(n_lanes*n), low(n_lanes), high(n_lanes), thinness
    integer :: i, k, l

    lanes = .true.
    do i = 1, size(self%layers)
      call self%layers(i)%operand%at(t, q, v, z)
      low = z(:n_lanes)
      high = low
      do k = 1, n - 1
        !GCC$ unroll 1
        do l = 1, n_lanes
          low(l) = min(low(l), z(n_lanes*k + l))
          high(l) = max(high(l), z(n_lanes*k + l))
        end do
      end do
      do l = 1, n_lanes
        if (.not. lanes(l)) cycle
        thinness = of_all(self%layers(i)%code, low(l), high(l))
        lanes(l) = thinness > 0.0_wp .and. thinness <= most
      end do
    end do
  end function followed

  !> Find the layers of a law.
  subroutine find_layers(law, layers)
    type(law_term), intent(in) :: law
    type(layer_type), allocatable, intent(out) :: layers(:)
    logical :: roots(size(law%program%code))
    real(wp) :: rough(law%program%n_surfaces())
    integer :: first, i, n, wanted
    logical :: by_number

    call find_roots(law%program%code, law%program%number, roots, rough)
    allocate (layers(size(law%program%code)))
    n = 0
    do i = 1, size(law%program%code)
      if (.not. bends(law%program%code(i), law%program%number(i)) .or. roots(i)) cycle
      ! atan2 with a number as its second operand is atan of the quotient.
      by_number = law%program%code(i) == f_atan2
      if (by_number) by_number = law%program%code(i - 1) == put_number
      if (law%program%code(i) == f_atan2 .and. .not. by_number) cycle
      ! For a quotient, the operand is the divisor.
      wanted = merge(2, 1, by_number)
      first = i
      do while (wanted > 0)
        first = first - 1
        wanted = wanted - 1 + operands(law%program%code(first))
      end do
      n = n + 1
      layers(n)%code = law%program%code(i)
      associate (operand => layers(n)%operand)
        operand%program%n_arguments = law%program%n_arguments
        operand%program%code = law%program%code(first:i - 1)
        operand%program%number = law%program%number(first:i - 1)
        if (by_number) then
          layers(n)%code = f_atan
          operand%program%code = [operand%program%code, divide]
          operand%program%number = [operand%program%number, 0.0_wp]
        end if
        call operand%program%measure()
        operand%by_q = law%arguments
        operand%by_v = law%rates
      end associate
    end do
    layers = layers(:n)
  end subroutine find_layers

  !> True if an instruction is not a polynomial in its last operand.
  pure logical function bends(code, number)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    select case (code)
    case (divide, f_sin, f_cos, f_tan, f_asin, f_acos, f_atan, f_atan2, f_sinh, f_cosh, f_tanh, &
          f_asinh, f_acosh, f_atanh, f_exp, f_log, f_sqrt)
      bends = .true.
    case (known_power)
      bends = number < 0.0_wp .or. .not. is_whole(number)
    case default
      bends = .false.
    end select
  end function bends

  !> Thinness: change of an operand in a step relative to the change that a polynomial resolves.
  !! Values up to 1 are resolved.
  real(wp) function thinness(layer, t, places, q, v, apart, most)
    type(layer_type), intent(in) :: layer
    !> Times; positions of the samples, ascending; states, shape (n, n_dof).
    real(wp), intent(in) :: t(:), places(:), q(:, :), v(:, :)
    !> True: states at ends of steps (the largest thinness counts); false: within one step.
    logical, intent(in) :: apart
    !> Thinness of all values together that makes checks of single steps unnecessary.
    real(wp), intent(in) :: most
    real(wp) :: z(size(t)), low, high
    integer :: first, i, last

    call layer%operand%at(t, q, v, z)
    if (.not. apart) then
      call reach(places, z, low, high)
      thinness = of_range(layer%code, [minval(z), maxval(z)], low, high, doubt*(high - low))
      if (thinness > 0.0_wp .and. size(z) > 2) thinness = max(thinness, &
                                                        of_parabola(layer%code, places, z))
      return
    end if
    ! If the range of all values is resolved, so is each step.
    thinness = of_all(layer%code, minval(z), maxval(z))
    if (thinness > 0.0_wp .and. thinness <= most) return
    thinness = 0.0_wp
    do i = 1, size(z) - 1
      first = max(i - 1, 1)
      last = min(i + 2, size(z))
      call reach(places(first:last), z(first:last), low, high)
      thinness = max(thinness, of_range(layer%code, [minval(z(first:last)), &
                                                     maxval(z(first:last))], low, high, high - low))
    end do
  end function thinness

  !> Thinness for an operand whose values over several steps lie between two values.
  pure real(wp) function of_all(code, low, high) result(thinness)
    integer, intent(in) :: code
    real(wp), intent(in) :: low, high
    thinness = of_range(code, [low, high], 1.5_wp*low - 0.5_wp*high, 1.5_wp*high - 0.5_wp*low, &
                        0.0_wp)
  end function of_all

  !> Thinness for an operand within a range.
  pure real(wp) function of_range(code, z, low, high, more) result(thinness)
    integer, intent(in) :: code
    !> Smallest and largest sample; estimated range of the values, and its possible excess.
    real(wp), intent(in) :: z(2), low, high, more
    real(wp) :: distance, seen

    thinness = 0.0_wp
    seen = 1.0_wp
    select case (code)
    case (f_tanh)
      if (low - more > flat .or. high + more < -flat) return
      distance = nearby*half_pi
    case (f_atan, f_asinh)
      distance = nearby*hypot(1.0_wp, max(0.0_wp, low, -high))
    case (f_exp)
      if (high + more < nothing) return
      distance = none
    case (f_sin, f_cos, f_sinh, f_cosh)
      distance = none
    case (f_tan)
      distance = nearby*half_pi
    case (f_asin, f_acos, f_atanh)
      seen = 1.0_wp - max(-z(1), z(2))
      distance = ahead*(1.0_wp - max(high, -low))
    case (f_acosh)
      seen = z(1) - 1.0_wp
      distance = ahead*(low - 1.0_wp)
    case default
      seen = max(z(1), -z(2))
      distance = ahead*max(low, -high)
    end select
    ! Crossing a singularity ends the solution; this is reported elsewhere.
    if (seen > 0.0_wp) thinness = (high - low)/max(distance, closest*seen)
  end function of_range

  !> Thinness for an operand that is a parabola in time, such as a squared deflection: from the
  !! singularities as a function of time, or from the decay of powers without singularities.
  pure real(wp) function of_parabola(code, x, z) result(thinness)
    integer, intent(in) :: code
    real(wp), intent(in) :: x(:), z(:)
    !> Required r; coefficients of an exponent with errors of 1e-11 at degree 16.
    real(wp), parameter :: wanted = 4.9_wp, first = 1.5_wp, second = 0.15_wp
    !> Singularities further away than 1/`far` are ignored.
    real(wp), parameter :: far = 1.0e-8_wp
    complex(wp) :: at(2), root
    real(wp) :: a, b, c, half, off, slope, r
    integer :: i, k, m, n

    n = size(z)
    m = (n + 1)/2
    ! z = a + b s + c s^2 on s = -1 ... 1.
    slope = (z(m) - z(1))/(x(m) - x(1))
    c = ((z(n) - z(m))/(x(n) - x(m)) - slope)/(x(n) - x(1))
    half = 0.5_wp*(x(n) - x(1))
    off = x(1) + half - x(m)
    a = z(1) + half*(slope + c*off)
    b = half*(slope + c*(half + off))
    c = c*half**2
    select case (code)
    case (f_tanh)
      at = [cmplx(0, half_pi, wp), cmplx(0, -half_pi, wp)]
    case (f_atan, f_asinh)
      at = [(0.0_wp, 1.0_wp), (0.0_wp, -1.0_wp)]
    case (f_asin, f_acos, f_atanh)
      at = [(1.0_wp, 0.0_wp), (-1.0_wp, 0.0_wp)]
    case (f_acosh)
      at = (1.0_wp, 0.0_wp)
    case (f_exp, f_sin, f_cos, f_sinh, f_cosh)
      thinness = max(abs(b)/first, abs(c)/second)
      return
    case (f_tan)
      at = half_pi*nint(a/half_pi)
    case default
      at = (0.0_wp, 0.0_wp)
    end select
    r = huge(1.0_wp)
    do k = 1, 2
      ! Roots of c s^2 + b s + a - z = 0 without cancellation.
      root = sqrt(b*b - 4.0_wp*c*(a - at(k)))
      if (real(b*root) < 0.0_wp) root = -root
      root = -0.5_wp*(b + root)
      do i = 1, 2
        if (i == 1) then
          if (abs(root) > far*abs(a - at(k))) r = min(r, ellipse((a - at(k))/root))
        else if (abs(c) > far*abs(root)) then
          r = min(r, ellipse(root/c))
        end if
      end do
    end do
    r = max(r, 1.0_wp + 1.0e-6_wp)
    thinness = 0.0_wp
    if (r < 1.0_wp/far) thinness = (wanted - 1.0_wp/wanted)/(r - 1.0_wp/r)

  contains

    !> Parameter of the ellipse about -1 ... 1 through a point.
    pure real(wp) function ellipse(s)
      complex(wp), intent(in) :: s
      complex(wp) :: w
      w = sqrt(s*s - 1.0_wp)
      ellipse = max(abs(s + w), abs(s - w))
    end function ellipse

  end function of_parabola

  !> Smallest and largest value of a smooth function, from parabolas through neighboring samples.
  pure subroutine reach(x, z, low, high)
    real(wp), intent(in) :: x(:), z(:)
    real(wp), intent(out) :: low, high
    real(wp) :: slope, curvature, top, value
    integer :: i

    low = minval(z)
    high = maxval(z)
    do i = 2, size(z) - 1
      slope = (z(i) - z(i - 1))/(x(i) - x(i - 1))
      curvature = ((z(i + 1) - z(i))/(x(i + 1) - x(i)) - slope)/(x(i + 1) - x(i - 1))
      if (.not. abs(curvature) > 0.0_wp) cycle
      top = 0.5_wp*(x(i) + x(i - 1) - slope/curvature)
      if (top <= x(i - 1) .or. top >= x(i + 1)) cycle
      value = z(i) + (slope + curvature*(top - x(i - 1)))*(top - x(i))
      low = min(low, value)
      high = max(high, value)
    end do
  end subroutine reach

end module viscovib_law_layers
