! Optimize: -O2 -fvect-cost-model=dynamic
!> The residual of the motion of third order in the full equations, and the correction that it
!! causes: an a posteriori estimate of the error.
!!
!! For fixed amplitudes the motion is a function of the angles of its generators
!! (`viscovib_motion_lattice`). The motion and its derivatives are substituted into the full
!! equations (all degrees) at the points of a lattice over these angles. The Fourier terms of the
!! residual, E_h exp(i h.theta) with orders |h| <= 4, give
!!
!!   L(s_h) U_h + sum_j g_jh L[s_h, s_j] r_j = -E_h
!!
!! as for terms of the expansion: a motion U_h if no mode is near, otherwise a change g_jh of the
!! amplitude of this mode. Quadratic terms of U and the motion are as large as the next order of E.
!! So with quadratic terms the motion plus U is substituted a second time: the new correction is
!! added to U, and g is then the whole change. If the amplitude of a term changes slowly, memory is
!! represented by (1 - R)(s_h) and its first two derivatives.
!!
!! The same linearised in a small amplitude of a mode at rest gives the rates of change of all modes
!! by it: its angle is no angle of the lattice then, but a factor exp(i angle) of all terms.
module viscovib_motion_defect
  use viscovib_fourier, only: real_spectrum
  use viscovib_kinds, only: wp
  use viscovib_motion_lattice, only: angles_type, find_angles, highest_order, lattice_of, &
    list_orders, max_angles, sample_change, sample_generators, sample_motion
  use viscovib_multiple_scales, only: multiple_scales_type
  use viscovib_polynomial_form, only: full_system_type
  implicit none
  private

  public :: changes_type, defect_type, find_changes, find_defect

  !> In natural units, one column for each Fourier term; of a term and its conjugate, the one with a
  !! negative frequency is omitted.
  type :: defect_type
    integer :: n = 0
    !> False: there are more angles than the limit, and the defect was not computed.
    logical :: known = .true.
    real(wp), allocatable :: frequency(:)
    !> Frequency in the frame: the phase of the term at time t is this times t.
    real(wp), allocatable :: phase_rate(:)
    !> U_h, shape (n, n_waves), and g_jh, shape (n_modes, n_waves).
    complex(wp), allocatable :: u(:, :), rates(:, :)
  end type defect_type

  !> Changes of all modes by the amplitude of a mode at rest, one column for each Fourier term: its
  !! frequency, the rates of change divided by the amplitude, shape (n_modes, n_waves), and whether
  !! they are proportional to the amplitude itself or to its conjugate.
  type :: changes_type
    real(wp), allocatable :: frequency(:)
    complex(wp), allocatable :: rates(:, :)
    logical, allocatable :: by_conjugate(:)
  end type changes_type

  !> A motion at the points of a lattice: angles, steps of the lattice, generators, waves of loads,
  !! unknowns with two derivatives, loads.
  type :: sampled_type
    type(angles_type) :: angles
    integer :: step(max_angles)
    complex(wp), allocatable :: g(:, :, :), wave(:, :, :)
    real(wp), allocatable :: y(:, :, :), load(:, :)
  end type sampled_type

contains

  subroutine find_defect(scales, full, a, defect, band, turns)
    type(multiple_scales_type), intent(in) :: scales
    !> The full system in the caller's units; not allocated: the form is the full system.
    class(full_system_type), intent(in), optional :: full
    !> Amplitudes in natural units and the frame.
    complex(wp), intent(in) :: a(:)
    type(defect_type), intent(out) :: defect
    !> Relative distance from a mode within which terms belong to g; default: the tolerance.
    real(wp), intent(in), optional :: band
    !> As in `find_angles`.
    real(wp), intent(in), optional :: turns(:)
    type(sampled_type) :: motion
    integer, allocatable :: orders(:, :)

    call sample(scales, a, motion, defect%known, turns)
    if (.not. defect%known) return
    call correct_once(scales, full, motion, orders, defect, band)
    if (.not. defect%known .or. size(scales%form%quadratic) == 0) return
    call add_waves(motion, orders, defect)
    call answer_sides(scales, full, motion, orders, defect, band)
  end subroutine find_defect

  !> Changes of all modes by small amplitudes of modes at rest.
  subroutine find_changes(scales, full, a, which, little, band, changes)
    type(multiple_scales_type), intent(in) :: scales
    !> As in `find_defect`.
    class(full_system_type), intent(in), optional :: full
    complex(wp), intent(in) :: a(:)
    !> Modes at rest.
    integer, intent(in) :: which(:)
    !> Amplitude for differences of the full equations; as in `find_defect`.
    real(wp), intent(in) :: little, band
    !> Shape (size(which)); without terms if they cannot be computed.
    type(changes_type), intent(out) :: changes(:)
    type(sampled_type) :: motion
    type(defect_type) :: defect
    integer, allocatable :: orders(:, :), half(:, :)
    complex(wp), allocatable :: w(:, :, :, :)
    integer :: i
    logical :: once

    do i = 1, size(which)
      allocate (changes(i)%frequency(0), changes(i)%rates(size(a), 0), changes(i)%by_conjugate(0))
    end do
    if (.not. little > 0.0_wp) return
    call sample(scales, a, motion, defect%known)
    if (.not. defect%known) return
    allocate (w(size(motion%y, 1), size(motion%y, 2), 0:2, size(which)))
    call list_orders(motion%angles%n, highest_order - 1, half)
    orders = reshape([half, pack(-half, spread(any(half /= 0, 1), 1, max_angles))], &
                     [max_angles, 2*size(half, 2) - 1])
    once = size(scales%form%quadratic) == 0
    do i = 1, size(which)
      call sample_change(scales, motion%g, motion%wave, which(i), w(:, :, :, i))
      call answer_change(scales, full, motion, orders, which(i), little, once, band, &
                         w(:, :, :, i), changes(i))
    end do
    if (once) return
    call correct_once(scales, full, motion, half, defect)
    if (.not. defect%known) return
    call add_waves(motion, half, defect)
    do i = 1, size(which)
      call answer_change(scales, full, motion, orders, which(i), little, .true., band, &
                         w(:, :, :, i), changes(i))
    end do
  end subroutine find_changes

  !> Sample the motion; `known` is false with too many angles.
  subroutine sample(scales, a, motion, known, turns)
    type(multiple_scales_type), intent(in) :: scales
    complex(wp), intent(in) :: a(:)
    type(sampled_type), intent(out) :: motion
    logical, intent(out) :: known
    !> As in `find_angles`.
    real(wp), intent(in), optional :: turns(:)
    integer :: n, k

    call find_angles(scales, a, motion%angles, turns)
    known = motion%angles%n <= max_angles
    if (.not. known) return
    call lattice_of(motion%angles%n, n, motion%step)
    associate (form => scales%form)
      allocate (motion%g(n, 0:2, 2*scales%normal%n_generators), &
                motion%wave(n, 0:2, size(form%drives)))
      allocate (motion%y(n, form%n, 0:2), motion%load(n, size(form%drives)))
      call sample_generators(scales, motion%angles, motion%step, a, motion%g, motion%wave)
      call sample_motion(scales, a, motion%g, motion%wave, motion%y)
      do k = 1, size(form%drives)
        motion%load(:, k) = real(motion%wave(:, 0, k))
      end do
    end associate
  end subroutine sample

  !> List the terms of the defect, and compute them from the residual of the motion.
  subroutine correct_once(scales, full, motion, orders, defect, band)
    type(multiple_scales_type), intent(in) :: scales
    class(full_system_type), intent(in), optional :: full
    type(sampled_type), intent(in) :: motion
    integer, allocatable, intent(out) :: orders(:, :)
    type(defect_type), intent(out) :: defect
    real(wp), intent(in), optional :: band
    integer :: i

    call list_orders(motion%angles%n, highest_order, orders)
    defect%n = size(orders, 2)
    allocate (defect%frequency(defect%n), defect%phase_rate(defect%n))
    allocate (defect%rates(scales%flow%n_modes, defect%n), &
              defect%u(scales%form%n, defect%n), source=(0.0_wp, 0.0_wp))
    associate (m => motion%angles%n)
      do i = 1, defect%n
        defect%frequency(i) = sum(orders(:m, i)*motion%angles%whole(:m))
        if (defect%frequency(i) < 0.0_wp) orders(:, i) = -orders(:, i)
        defect%phase_rate(i) = sum(orders(:m, i)*motion%angles%frequency(:m))
      end do
    end associate
    defect%frequency = abs(defect%frequency)
    call answer_sides(scales, full, motion, orders, defect, band)
  end subroutine correct_once

  !> The index of a term of this order in the spectrum of a signal on the lattice.
  pure integer function turn_of(motion, order)
    type(sampled_type), intent(in) :: motion
    integer, intent(in) :: order(:)
    turn_of = modulo(sum(order(:motion%angles%n)*motion%step(:motion%angles%n)), size(motion%y, 1))
  end function turn_of

  !> The growth of the amplitude of a term.
  pure real(wp) function growth_of(motion, order)
    type(sampled_type), intent(in) :: motion
    integer, intent(in) :: order(:)
    associate (m => motion%angles%n)
      growth_of = sum(abs(order(:m))*motion%angles%growth(:m))
    end associate
  end function growth_of

  !> Add U and its derivatives at the points of the lattice to y, for all terms at once: Re sum_t
  !! c_t exp(2 pi i t k/n) is Re C + Im D, with the transforms C and D of the real and the imaginary
  !! parts of c.
  subroutine add_waves(motion, orders, defect)
    type(sampled_type), intent(inout) :: motion
    integer, intent(in) :: orders(:, :)
    type(defect_type), intent(in) :: defect
    complex(wp), dimension(size(motion%y, 1)/2 + 1) :: of_real, of_imaginary
    complex(wp) :: c(0:size(motion%y, 1) - 1), s(defect%n)
    integer :: turn(defect%n), points, i, d, row

    points = size(motion%y, 1)
    do i = 1, defect%n
      turn(i) = turn_of(motion, orders(:, i))
      s(i) = cmplx(growth_of(motion, orders(:, i)), defect%frequency(i), wp)
    end do
    do row = 1, size(motion%y, 2)
      do d = 0, 2
        c = (0.0_wp, 0.0_wp)
        do i = 1, defect%n
          c(turn(i)) = c(turn(i)) + 2.0_wp*defect%u(row, i)*s(i)**d
        end do
        call real_spectrum(real(c), of_real)
        call real_spectrum(aimag(c), of_imaginary)
        associate (y => motion%y)
          do i = 1, points/2 + 1
            y(i, row, d) = y(i, row, d) + (real(of_real(i)) + aimag(of_imaginary(i)))
          end do
          do i = points/2 + 2, points
            y(i, row, d) = y(i, row, d) + (real(of_real(points + 2 - i)) &
                                           - aimag(of_imaginary(points + 2 - i)))
          end do
        end associate
      end do
    end do
  end subroutine add_waves

  !> Without a kernel: the whole residual of the equation; with a kernel: the terms it acts on.
  subroutine evaluate_sides(scales, full, y, load, e)
    type(multiple_scales_type), intent(in) :: scales
    class(full_system_type), intent(in), optional :: full
    real(wp), intent(in), contiguous :: y(:, :, 0:), load(:, :)
    real(wp), intent(out), contiguous :: e(:, :)
    real(wp), allocatable :: own(:, :, :)
    real(wp) :: x(size(y, 1), scales%form%n_arguments)
    integer :: i

    associate (form => scales%form)
      if (present(full)) then
        allocate (own(size(y, 1), form%n, 0:2))
        do i = 1, form%n
          own(:, i, :) = scales%columns(i)*y(:, i, :)
          own(:, i, 0) = own(:, i, 0) + scales%rest(i)
        end do
        call full%sides(own, load*spread(scales%load_factor, 1, size(load, 1)), e)
        do i = 1, form%n
          e(:, i) = scales%rows(i)*e(:, i)
        end do
        return
      end if
      do i = 1, form%n_arguments
        x(:, i) = y(:, form%source(i), form%derivative(i))
      end do
      e = matmul(y(:, :, 0), transpose(form%hereditary))
      do i = 1, size(form%quadratic)
        associate (t => form%quadratic(i))
          e(:, t%row) = e(:, t%row) + t%coefficient*x(:, t%at(1))*x(:, t%at(2))
        end associate
      end do
      do i = 1, size(form%cubic)
        associate (t => form%cubic(i))
          e(:, t%row) = e(:, t%row) + t%coefficient*x(:, t%at(1))*x(:, t%at(2))*x(:, t%at(3))
        end associate
      end do
      do i = 1, form%n
        if (form%kernel_of(i) > 0) cycle
        e(:, i) = e(:, i) + matmul(y(:, :, 0), form%linear(i, :, 0)) &
                  + matmul(y(:, :, 1), form%linear(i, :, 1)) &
                  + matmul(y(:, :, 2), form%linear(i, :, 2)) - matmul(load, form%load(i, :))
      end do
    end associate
  end subroutine evaluate_sides

  !> First and second derivative of the terms that memory acts on, up to the third degree.
  subroutine slow_sides(scales, y, w)
    type(multiple_scales_type), intent(in) :: scales
    real(wp), intent(in), contiguous :: y(:, :, 0:)
    real(wp), intent(out), contiguous :: w(:, :, :)
    complex(wp) :: x(scales%form%n_arguments, 0:2)
    integer :: k, d

    associate (form => scales%form)
      do k = 1, size(y, 1)
        ! Memory acts on terms of the unknowns, not of their derivatives.
        do d = 0, 2
          x(:, d) = y(k, form%source, d)
        end do
        w(k, :, 1) = matmul(form%hereditary, y(k, :, 1)) &
                     + real(2.0_wp*form%quadratic_at(x(:, 0), x(:, 1)) &
                            + 3.0_wp*form%cubic_at(x(:, 0), x(:, 0), x(:, 1)))
        w(k, :, 2) = matmul(form%hereditary, y(k, :, 2)) &
                     + real(2.0_wp*(form%quadratic_at(x(:, 0), x(:, 2)) &
                                    + form%quadratic_at(x(:, 1), x(:, 1))) &
                            + 3.0_wp*(form%cubic_at(x(:, 0), x(:, 0), x(:, 2)) &
                                      + 2.0_wp*form%cubic_at(x(:, 0), x(:, 1), x(:, 1))))
      end do
    end associate
  end subroutine slow_sides

  !> One iteration: add the response to the terms of the residual to U; compute g.
  subroutine answer_sides(scales, full, motion, orders, defect, band)
    type(multiple_scales_type), intent(in) :: scales
    class(full_system_type), intent(in), optional :: full
    type(sampled_type), intent(in) :: motion
    integer, intent(in) :: orders(:, :)
    type(defect_type), intent(inout) :: defect
    real(wp), intent(in), optional :: band
    real(wp) :: e(size(motion%y, 1), scales%form%n), w(size(motion%y, 1), scales%form%n, 2)
    complex(wp), dimension(size(motion%y, 1)/2 + 1, scales%form%n) :: of_e, of_slope, of_bend
    complex(wp) :: of_y(size(motion%y, 1)/2 + 1, scales%form%n, 0:2)
    complex(wp) :: rates(2*scales%normal%n_generators), u(scales%form%n), waves(scales%form%n)
    real(wp) :: whole(scales%flow%n_modes)
    integer :: i, k, d, turn
    logical :: memory, singular

    call evaluate_sides(scales, full, motion%y, motion%load, e)
    memory = scales%form%has_memory()
    if (memory) call slow_sides(scales, motion%y, w)
    do k = 1, scales%form%n
      call real_spectrum(e(:, k), of_e(:, k))
      if (.not. memory) cycle
      call real_spectrum(w(:, k, 1), of_slope(:, k))
      call real_spectrum(w(:, k, 2), of_bend(:, k))
      do d = 0, 2
        call real_spectrum(motion%y(:, k, d), of_y(:, k, d))
      end do
    end do
    whole = scales%flow%frame
    do k = 1, size(whole)
      associate (angle => motion%angles%of_mode(k))
        if (angle > 0) whole(k) = motion%angles%whole(angle)
      end associate
    end do
    do i = 1, defect%n
      turn = turn_of(motion, orders(:, i))
      waves = wave_of(of_e, turn)
      associate (s => cmplx(growth_of(motion, orders(:, i)), defect%frequency(i), wp))
        if (memory) then
          call remember(scales, s, wave_of(of_slope, turn), wave_of(of_bend, turn), &
                        reshape([(wave_of(of_y(:, :, d), turn), d=0, 2)], [scales%form%n, 3]), &
                        waves)
        end if
        call scales%normal%answer(scales%form, cmplx(0.0_wp, aimag(at_least(scales, s)), wp), &
                                  -waves, scales%normal%near_modes(aimag(s), whole, band), u, &
                                  rates, singular)
      end associate
      defect%rates(:, i) = rates(:scales%flow%n_modes)
      ! The stiffness vanishes: there is no finite response.
      if (singular .and. any(abs(waves) > 0.0_wp)) defect%known = .false.
      ! The mean is real: it is not doubled by a conjugate.
      if (all(orders(:, i) == 0)) u = 0.5_wp*u
      defect%u(:, i) = defect%u(:, i) + u
    end do

  contains

    !> Mean of a signal times exp(-2 pi i turn k/points), of each row.
    pure function wave_of(spectrum, turn) result(wave)
      complex(wp), intent(in) :: spectrum(:, :)
      integer, intent(in) :: turn
      complex(wp) :: wave(size(spectrum, 2))
      associate (points => size(motion%y, 1))
        if (turn <= points/2) then
          wave = spectrum(turn + 1, :)/points
        else
          wave = conjg(spectrum(points - turn + 1, :))/points
        end if
      end associate
    end function wave_of

  end subroutine answer_sides

  !> A kernel without an integral: the transform at a small s replaces that at 0.
  function at_least(scales, s) result(place)
    type(multiple_scales_type), intent(in) :: scales
    complex(wp), intent(in) :: s
    complex(wp) :: place
    real(wp) :: slowest
    slowest = 0.0_wp
    if (scales%form%has_memory()) slowest = 1.0e-6_wp*maxval(abs(scales%flow%s))
    place = cmplx(real(s), max(aimag(s), slowest), wp)
  end function at_least

  !> The residual of a term with memory, from the terms that memory acts on.
  subroutine remember(scales, s, slope, bend, of_y, waves)
    type(multiple_scales_type), intent(in) :: scales
    !> Exponent of the term.
    complex(wp), intent(in) :: s
    !> Terms of the derivatives of the terms that memory acts on, shape (n); of the unknowns and
    !! their derivatives, shape (n, 0:2).
    complex(wp), intent(in) :: slope(:), bend(:), of_y(:, 0:)
    !> Terms that memory acts on, then the residual.
    complex(wp), intent(inout) :: waves(:)
    complex(wp), dimension(size(waves)) :: first, second, whole
    complex(wp) :: at
    integer :: d

    at = at_least(scales, s)
    associate (form => scales%form)
      whole = form%retained(at)*waves
      if (aimag(s) > 0.0_wp) then
        first = slope - at*waves
        second = bend - 2.0_wp*at*slope + at**2*waves
        whole = whole + first*form%retained_between([at, at]) &
                + second*form%retained_between([at, at, at])
      end if
      do d = 0, 2
        whole = whole + matmul(form%linear(:, :, d), of_y(:, d))
      end do
      where (form%kernel_of > 0) waves = whole
    end associate
  end subroutine remember

  !> One iteration for the change w by mode j at rest: its rates; unless it is the last one, add the
  !! response to w.
  subroutine answer_change(scales, full, motion, orders, j, little, last, band, w, change)
    type(multiple_scales_type), intent(in) :: scales
    class(full_system_type), intent(in), optional :: full
    type(sampled_type), intent(in) :: motion
    integer, intent(in) :: orders(:, :), j
    real(wp), intent(in) :: little, band
    logical, intent(in) :: last
    complex(wp), intent(inout) :: w(:, :, 0:)
    type(changes_type), intent(inout) :: change
    complex(wp), dimension(0:size(w, 1) - 1, size(w, 2), 0:2) :: e, of_w, more
    complex(wp) :: s, waves(size(w, 2)), u(size(w, 2)), rates(2*scales%normal%n_generators)
    integer :: i, d, turn
    logical :: acts(2*scales%normal%n_generators), singular

    call differentiate(scales, full, motion, w, little, e)
    call transform(e(:, :, 0))
    if (scales%form%has_memory()) then
      of_w = w
      do d = 0, 2
        if (d > 0) call transform(e(:, :, d))
        call transform(of_w(:, :, d))
      end do
    end if
    more = (0.0_wp, 0.0_wp)
    if (size(change%frequency) == 0) call list_terms()
    do i = 1, size(orders, 2)
      change%rates(:, i) = (0.0_wp, 0.0_wp)
      acts = scales%normal%near_modes(change%frequency(i), scales%flow%frame, band)
      if (last .and. .not. any(acts(:scales%flow%n_modes))) cycle
      turn = turn_of(motion, orders(:, i))
      s = cmplx(growth_of(motion, orders(:, i)), change%frequency(i), wp)
      if (.not. scales%normal%steady) s = s + real(scales%flow%s(j))
      waves = seen(e(turn, :, 0))
      if (scales%form%has_memory()) then
        call remember(scales, s, seen(e(turn, :, 1)), seen(e(turn, :, 2)), &
                      reshape([(seen(of_w(turn, :, d)), d=0, 2)], [size(waves), 3]), waves)
      end if
      call scales%normal%answer(scales%form, cmplx(0.0_wp, aimag(at_least(scales, s)), wp), &
                                -waves, acts, u, rates, singular)
      if (singular .and. any(abs(waves) > 0.0_wp)) then
        call forget(change)
        return
      end if
      change%rates(:, i) = rates(:scales%flow%n_modes)
      do d = 0, 2
        more(turn, :, d) = more(turn, :, d) + seen(u*s**d)
      end do
    end do
    if (last) return
    do d = 0, 2
      more(:, :, d) = conjg(more(:, :, d))
      call transform(more(:, :, d))
      w(:, :, d) = w(:, :, d) + size(w, 1)*conjg(more(:, :, d))
    end do

  contains

    !> Of a term whose frequency is negative, the conjugate is used.
    subroutine list_terms()
      associate (f => [(sum(orders(:motion%angles%n, i)*motion%angles%frequency(:motion%angles%n)) &
                        + scales%flow%frame(j), i=1, size(orders, 2))])
        change%frequency = abs(f)
        change%by_conjugate = f < 0.0_wp
      end associate
      deallocate (change%rates)
      allocate (change%rates(scales%flow%n_modes, size(orders, 2)))
    end subroutine list_terms

    function seen(z)
      complex(wp), intent(in) :: z(:)
      complex(wp) :: seen(size(z))
      seen = z
      if (change%by_conjugate(i)) seen = conjg(z)
    end function seen

  end subroutine answer_change

  !> The change is not known.
  subroutine forget(change)
    type(changes_type), intent(inout) :: change
    change%frequency = change%frequency(:0)
    change%by_conjugate = change%by_conjugate(:0)
    change%rates = change%rates(:, :0)
  end subroutine forget

  !> Linear change of the sides and, with memory, of their first and second derivatives, by central
  !! differences.
  subroutine differentiate(scales, full, motion, w, little, e)
    type(multiple_scales_type), intent(in) :: scales
    class(full_system_type), intent(in), optional :: full
    type(sampled_type), intent(in) :: motion
    complex(wp), intent(in) :: w(:, :, 0:)
    real(wp), intent(in) :: little
    !> Shape (n_points, n, 0:2); derivatives are set only with memory.
    complex(wp), intent(out) :: e(:, :, 0:)
    real(wp) :: y(4*size(w, 1), size(w, 2), 0:2), load(4*size(w, 1), size(motion%load, 2))
    real(wp) :: sides(4*size(w, 1), size(w, 2), 0:2)
    integer :: n, k, d

    n = size(w, 1)
    do k = 0, 3
      load(k*n + 1:(k + 1)*n, :) = motion%load
    end do
    do d = 0, 2
      do k = 1, size(w, 2)
        y(:n, k, d) = motion%y(:, k, d) + little*real(w(:, k, d))
        y(n + 1:2*n, k, d) = motion%y(:, k, d) - little*real(w(:, k, d))
        y(2*n + 1:3*n, k, d) = motion%y(:, k, d) + little*aimag(w(:, k, d))
        y(3*n + 1:, k, d) = motion%y(:, k, d) - little*aimag(w(:, k, d))
      end do
    end do
    call evaluate_sides(scales, full, y, load, sides(:, :, 0))
    if (scales%form%has_memory()) call slow_sides(scales, y, sides(:, :, 1:))
    do d = 0, merge(2, 0, scales%form%has_memory())
      do k = 1, size(w, 2)
        e(:, k, d) = cmplx(sides(:n, k, d) - sides(n + 1:2*n, k, d), &
                           sides(2*n + 1:3*n, k, d) - sides(3*n + 1:, k, d), wp)/(2.0_wp*little)
      end do
    end do
  end subroutine differentiate

  !> Mean of each column times exp(-2 pi i t k/n), for t = 0 ... n - 1.
  subroutine transform(z)
    complex(wp), intent(inout) :: z(0:, :)
    complex(wp), dimension(0:size(z, 1)/2) :: of_real, of_imaginary
    integer :: n, k, t
    n = size(z, 1)
    do k = 1, size(z, 2)
      call real_spectrum(real(z(:, k)), of_real)
      call real_spectrum(aimag(z(:, k)), of_imaginary)
      do t = n/2 + 1, n - 1
        z(t, k) = conjg(of_real(n - t) - (0.0_wp, 1.0_wp)*of_imaginary(n - t))/n
      end do
      z(:n/2, k) = (of_real + (0.0_wp, 1.0_wp)*of_imaginary)/n
    end do
  end subroutine transform

end module viscovib_motion_defect
