! Optimize: -O3
!> Modes of a structure from the motion of its condensed coordinates.
!!
!! A harmonic of the condensed coordinates is y = f + H(s) g, s = i k nu, with the motion f by the
!! load and the forces g of the elements on the linear subsystem. A mode with the load p has the
!! amplitude t (p + pushed . g), t = 1/(squares + i losses + rates s + s^2).
!!
!! Near a resonance the terms of few modes hide all others in H. Their amplitudes are then
!! additional unknowns (`viscovib_resonant_compliance`). At an antiresonance H nearly vanishes
!! although its terms do not: the element is at rest for any force. The force is then that of the
!! law of the element, if it has the smaller rounding error.
module viscovib_modal_motion
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_quiet_nan, ieee_value
  use viscovib_compliance, only: push_type
  use viscovib_dense, only: invert, solve_complex
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_mode_sums, only: apart, resonances
  use viscovib_resonant_compliance, only: bordered_matrix
  use viscovib_status, only: status_type
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: modal_finder

  !> A mode is near a resonance if |1/t| is less than this part of |squares|.
  real(wp), parameter :: nearby = 1.0e-2_wp
  !> Cancellation in H from which on rounding errors are estimated, and relative size of a harmonic
  !! below which they are not.
  real(wp), parameter :: cancelled = 100.0_wp, negligible = 1.0e-10_wp
  !> Relative rounding error of a motion from which on forces of laws are computed, relative
  !! difference of motions for their derivatives, and tolerance of iterations.
  real(wp), parameter :: worth = 3.0e-14_wp, difference = 1.0e-6_wp, ended = 1.0e-8_wp
  real(wp), parameter :: eps = epsilon(1.0_wp)

  type :: modal_finder
    !> True for motions of the forces linearized at zero.
    logical :: linear = .false.
    !> The forces of the laws, for these harmonics.
    type(balance_type), private :: balance
    integer, private :: highest = -1
    logical, private :: half_wave = .false.
    !> Forces of laws g of the present motion and of a motion nearby, shape (n_orders, q); not
    !! allocated: not computed.
    complex(wp), allocatable, private :: at(:, :), beyond(:, :)
  contains
    procedure :: find
  end type modal_finder

contains

  !> Amplitudes of real and complex modes, and forces g, of one motion; NaN if it is not known.
  subroutine find(self, system, nu, factor, orders, y, modes, poles, forces)
    class(modal_finder), intent(inout) :: self
    type(structure_type), intent(in) :: system
    !> Frequency (rad/s), and load factor.
    real(wp), intent(in) :: nu, factor
    integer, intent(in) :: orders(:)
    !> Relative to the base, shape (n_orders, q).
    complex(wp), intent(in) :: y(:, :)
    !> Shapes (n_modes, n_orders), (n_poles, n_orders) and (q, n_orders).
    complex(wp), intent(out) :: modes(:, :), poles(:, :), forces(:, :)
    type(push_type) :: push
    complex(wp) :: known(size(y, 1), size(y, 2)), unknown
    real(wp) :: mu
    integer :: j, k

    if (allocated(self%at)) deallocate (self%at, self%beyond)
    known = merge(y, (0.0_wp, 0.0_wp), ieee_is_finite(real(y)) .and. ieee_is_finite(aimag(y)))
    do k = 1, size(orders)
      mu = 0.0_wp
      if (orders(k) > 0) mu = orders(k)*nu
      if (.not. (all(ieee_is_finite(real(y(k, :)))) .and. all(ieee_is_finite(aimag(y(k, :)))) &
                 .and. ieee_is_finite(mu))) then
        unknown = cmplx(ieee_value(mu, ieee_quiet_nan), ieee_value(mu, ieee_quiet_nan), wp)
        modes(:, k) = unknown
        poles(:, k) = unknown
        forces(:, k) = unknown
        cycle
      end if
      j = findloc(system%loads%order, orders(k), 1)
      if (j > 0) then
        call system%loads(j)%find_push(mu, push)
        push%modes = factor*push%modes
        push%poles = factor*push%poles
        push%flexible = factor*push%flexible
      else
        push%modes = 0.0_wp*system%rest%squares + (0.0_wp, 0.0_wp)
        push%poles = 0.0_wp*system%rest%poles
        push%flexible = 0.0_wp*y(k, :)
      end if
      if (orders(k) == 0) then
        call system%static%find(system%rest, y(k, :), push, forces(:, k), modes(:, k), poles(:, k))
      else
        call find_harmonic(self, system, nu, orders, k, known, push, modes(:, k), poles(:, k), &
                           forces(:, k))
      end if
    end do
  end subroutine find

  !> The same for harmonic k > 0.
  subroutine find_harmonic(self, system, nu, orders, k, y, push, modes, poles, g)
    class(modal_finder), intent(inout) :: self
    type(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu
    integer, intent(in) :: orders(:), k
    complex(wp), intent(in) :: y(:, :)
    type(push_type), intent(in) :: push
    complex(wp), intent(out) :: modes(:), poles(:), g(:)
    complex(wp) :: t(size(modes)), quiet(size(modes)), w(size(poles)), s
    real(wp), dimension(size(system%rest%squares)) :: re, im
    complex(wp), allocatable :: matrix(:, :), found(:)
    integer, allocatable :: near(:)
    logical :: singular
    integer :: a, i, n, q

    n = size(modes)
    q = size(g)
    s = cmplx(0.0_wp, orders(k)*nu, wp)
    associate (rest => system%rest)
      call resonances(size(re), rest%squares, rest%rates, rest%losses, s, re, im)
      t = cmplx(re(:n), im(:n), wp)
      w = 1.0_wp/apart(s, rest%poles)
      near = pack([(i, i=1, n)], nearby*abs(rest%squares(:n))*abs(t) > 1.0_wp)
      if (self%linear .and. are_hereditary(system)) then
        g = matmul(hereditary(system, aimag(s)), y(k, :))
        if (size(near) == 0 .or. .not. any(abs(g) > 0.0_wp)) then
          call set_amplitudes(system, push, t, w, g, modes, poles)
          return
        end if
      end if
      quiet = t
      quiet(near) = (0.0_wp, 0.0_wp)
      allocate (matrix(q + size(near), q + size(near)), found(q + size(near)))
      call bordered_matrix(rest, near, aimag(s), matrix)
      modes = quiet*push%modes(:n)
      poles = w*push%poles
      do a = 1, q
        found(a) = y(k, a) - push%flexible(a) - sum(rest%seen(:n, a)*modes) &
                   - sum(rest%left(:, a)*poles)
      end do
      found(q + 1:) = -push%modes(near)
      call solve_complex(matrix, found, .false., singular)
      if (singular) found = (0.0_wp, 0.0_wp)
      g = found(:q)
      call set_amplitudes(system, push, quiet, w, g, modes, poles)
      modes(near) = found(q + 1:)
    end associate
    call replace_by_laws()

  contains

    !> Take the forces of the laws if the solution for g loses more digits.
    subroutine replace_by_laws()
      complex(wp) :: inverse(size(found), size(found)), law(q)
      real(wp) :: size_of(size(found), size(found)), terms(size(found)), lost(size(found))
      real(wp) :: sizes(q, q), seen(n, q), pushed(n, q), left(size(w), q), right(size(w), q)
      real(wp) :: of_modes(n), of_poles(size(w)), bend, own, error
      logical :: useless

      call invert(matrix, inverse, useless)
      if (useless .or. singular) return
      size_of = abs(inverse)
      of_modes = abs(quiet)
      of_poles = abs(w)
      associate (rest => system%rest)
        own = maxval(of_modes)*maxval(sum(rest%seen**2, 1))
        if (size(w) > 0) own = own + maxval(of_poles) &
                               *sum(sum(abs(rest%left), 2)*sum(abs(rest%right), 2))
        if (maxval(sum(size_of(:q, :q), 2))*own <= cancelled) return
        if (maxval(abs(y(k, :))) + own*maxval(abs(g)) <= negligible*maxval(abs(y))) return
        seen = abs(rest%seen(:n, :))
        pushed = abs(rest%pushed(:n, :))
        left = abs(rest%left)
        right = abs(rest%right)
      end associate
      sizes = matmul(transpose(spread(of_modes, 2, q)*seen), pushed) &
              + matmul(transpose(spread(of_poles, 2, q)*left), right)
      if (maxval(matmul(size_of(:q, :q), sizes)) <= cancelled) return
      ! Rounding errors of the forces, of the amplitudes by them, and of the amplitudes by laws.
      terms(:q) = abs(y(k, :)) + matmul(sizes, abs(g)) &
                  + matmul(of_modes*abs(push%modes(:n)), seen) &
                  + matmul(of_poles*abs(push%poles), left)
      terms(q + 1:) = abs(push%modes(near)) + matmul(pushed(near, :), abs(g))
      lost = eps*matmul(size_of, terms)
      error = maxval([of_modes*matmul(pushed, lost(:q)), of_poles*matmul(right, lost(:q)), &
                      lost(q + 1:)])
      if (error <= worth*maxval([abs(modes), abs(poles)])) return
      call find_law(self, system, nu, orders, k, y, law, bend)
      if (any(abs(law - g) > 100.0_wp*lost(:q) &
              + ended*matmul(size_of(:q, :q), abs(y(k, :))))) return
      own = eps*bend*maxval(terms(:q))/max(maxval(abs(y)), tiny(own))
      if (own >= maxval(lost(:q))) return
      of_modes = abs(t)*(own*sum(pushed, 2) + eps*(abs(push%modes(:n)) + matmul(pushed, abs(law))))
      if (maxval([of_modes, of_poles*own*sum(right, 2)]) >= error) return
      g = law
      call set_amplitudes(system, push, t, w, g, modes, poles)
    end subroutine replace_by_laws

  end subroutine find_harmonic

  !> Amplitudes of the modes under a load and the forces g.
  pure subroutine set_amplitudes(system, push, t, w, g, modes, poles)
    type(structure_type), intent(in) :: system
    type(push_type), intent(in) :: push
    !> Responses of real and complex modes.
    complex(wp), intent(in) :: t(:), w(:)
    complex(wp), intent(in) :: g(:)
    complex(wp), intent(out) :: modes(:), poles(:)
    integer :: a

    modes = push%modes(:size(t))
    poles = push%poles
    do a = 1, size(g)
      modes = modes + system%rest%pushed(:size(t), a)*g(a)
      poles = poles + system%rest%right(:, a)*g(a)
    end do
    modes = t*modes
    poles = w*poles
  end subroutine set_amplitudes

  !> True if the linear forces of the elements are those of the kernels.
  pure logical function are_hereditary(system)
    type(structure_type), intent(in) :: system
    integer :: i
    are_hereditary = size(system%laws) == 0
    do i = 1, size(system%monomials)
      if (sum(system%monomials(i)%power) < 2) are_hereditary = .false.
    end do
  end function are_hereditary

  !> The matrix from deflections to linear forces g at mu. Their elastic part belongs to the linear
  !! subsystem.
  function hereditary(system, mu) result(matrix)
    type(structure_type), intent(in) :: system
    real(wp), intent(in) :: mu
    complex(wp) :: matrix(size(system%gather, 2), size(system%gather, 2))
    complex(wp) :: fraction(1, system%n_memory())
    integer :: b, j

    call system%retained([mu], fraction)
    matrix = (0.0_wp, 0.0_wp)
    do j = 1, size(system%kernel_of)
      if (system%kernel_of(j) == 0) cycle
      do b = 1, size(matrix, 2)
        matrix(:, b) = matrix(:, b) + system%spread(:, j)*(system%gather(j, b) &
                                                           *(1.0_wp - fraction(1, j)))
      end do
    end do
  end function hereditary

  !> Forces g of the laws in harmonic k, and the size of their derivative by the relative size of
  !! the motion.
  subroutine find_law(self, system, nu, orders, k, y, law, bend)
    class(modal_finder), intent(inout) :: self
    type(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu
    integer, intent(in) :: orders(:), k
    complex(wp), intent(in) :: y(:, :)
    complex(wp), intent(out) :: law(:)
    real(wp), intent(out) :: bend

    if (self%linear) then
      ! Harmonic k is the first harmonic at the frequency k nu.
      call prepare_balance(self, system, orders(k)*nu, [1])
      law = linear_forces(y(k, :))
      bend = maxval(abs(law))
      return
    end if
    if (.not. allocated(self%at)) then
      call prepare_balance(self, system, nu, orders)
      self%at = forces_of(y)
      self%beyond = forces_of((1.0_wp + difference)*y)
    end if
    law = self%at(k, :)
    bend = maxval(abs(self%beyond(k, :) - law))/difference

  contains

    function linear_forces(x) result(forces)
      complex(wp), intent(in) :: x(:)
      complex(wp) :: forces(size(x))
      real(wp), dimension(2, size(x)) :: rest, left
      real(wp) :: slopes(2*size(x), 2*size(x)), parts(2*size(x))

      rest = 0.0_wp
      call self%balance%residual(system, rest, left)
      call self%balance%derivatives(system, slopes)
      parts(1::2) = real(x)
      parts(2::2) = aimag(x)
      parts = matmul(slopes, parts)
      forces = -cmplx(parts(1::2), parts(2::2), wp)
    end function linear_forces

    function forces_of(x) result(forces)
      complex(wp), intent(in) :: x(:, :)
      complex(wp) :: forces(size(x, 1), size(x, 2))
      real(wp), dimension(2*size(self%balance%set%orders), size(x, 2)) :: parts, left
      integer :: i, j

      parts = 0.0_wp
      do i = 1, size(orders)
        j = findloc(self%balance%set%orders, orders(i), 1)
        parts(2*j - 1, :) = real(x(i, :))
        parts(2*j, :) = aimag(x(i, :))
      end do
      call self%balance%residual(system, parts, left)
      do i = 1, size(orders)
        j = findloc(self%balance%set%orders, orders(i), 1)
        forces(i, :) = -cmplx(left(2*j - 1, :), left(2*j, :), wp)
      end do
    end function forces_of

  end subroutine find_law

  !> A balance whose residual contains the forces of the elements only.
  subroutine prepare_balance(self, system, nu, orders)
    class(modal_finder), intent(inout) :: self
    type(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu
    integer, intent(in) :: orders(:)
    type(harmonic_set_type) :: set
    type(load_type) :: nothing
    type(status_type) :: status
    complex(wp) :: none(size(system%gather, 2), 0)
    logical :: half_wave
    integer :: k

    half_wave = all(mod(orders, 2) == 1)
    if (maxval(orders) /= self%highest .or. (half_wave .neqv. self%half_wave)) then
      self%highest = maxval(orders)
      self%half_wave = half_wave
      call new_harmonic_set(set, self%highest, half_wave, system%degree)
      call new_balance(self%balance, system, set)
    end if
    call new_load(nothing, size(none, 1), [integer ::], none, [complex(wp) ::], status)
    call self%balance%set_frequency(system, nothing, nu)
    do k = 1, size(self%balance%set%orders)
      self%balance%stiffness(:, :, k) = -hereditary(system, self%balance%set%orders(k)*nu)
    end do
  end subroutine prepare_balance

end module viscovib_modal_motion
