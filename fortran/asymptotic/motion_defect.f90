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
module viscovib_motion_defect
  use viscovib_fourier, only: real_spectrum
  use viscovib_kinds, only: wp
  use viscovib_motion_lattice, only: angles_type, find_angles, lattice_of, list_orders, &
    max_angles, sample_motion
  use viscovib_multiple_scales, only: multiple_scales_type
  use viscovib_polynomial_form, only: full_system_type
  implicit none
  private

  public :: defect_type, find_defect

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
    !> h, and the angle of each mode whose angle no load and no other mode has; 0: none.
    integer, allocatable :: orders(:, :), own_angle(:)
  end type defect_type

contains

  subroutine find_defect(scales, full, a, defect, band, turns, rates_only)
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
    !> Compute only g, for the terms near a mode.
    logical, intent(in), optional :: rates_only
    type(angles_type) :: angles
    real(wp), allocatable :: y(:, :, :), load(:, :), e(:, :), w(:, :, :)
    integer, allocatable :: orders(:, :)
    integer :: step(max_angles), n, i, round

    call find_angles(scales, a, angles, turns)
    defect%known = angles%n <= max_angles
    if (.not. defect%known) return
    call lattice_of(angles%n, n, step)
    call list_orders(angles%n, orders)
    defect%n = size(orders, 2)
    associate (form => scales%form, m => angles%n)
      allocate (defect%frequency(defect%n), defect%phase_rate(defect%n))
      allocate (defect%rates(scales%flow%n_modes, defect%n), defect%u(form%n, defect%n), &
                source=(0.0_wp, 0.0_wp))
      do i = 1, defect%n
        defect%frequency(i) = sum(orders(:m, i)*angles%whole(:m))
        if (defect%frequency(i) < 0.0_wp) orders(:, i) = -orders(:, i)
        defect%phase_rate(i) = sum(orders(:m, i)*angles%frequency(:m))
      end do
      defect%frequency = abs(defect%frequency)
      allocate (defect%orders, source=orders)
      defect%own_angle = [(merge(angles%of_mode(i), 0, count(angles%of_mode == angles%of_mode(i)) &
                                 + count(angles%of_load == angles%of_mode(i)) == 1), &
                           i=1, size(a))]
      allocate (y(n, form%n, 0:2), load(n, size(form%drives)), e(n, form%n), &
                w(n, form%n, 2))
      call sample_motion(scales, angles, step, a, y, load)
      do round = 1, merge(2, 1, size(form%quadratic) > 0)
        if (round > 1) call add_waves(angles, step, orders, defect, y)
        call evaluate_sides(scales, full, y, load, e)
        if (form%has_memory()) call slow_sides(scales, y, w)
        call answer_waves(scales, angles, step, orders, y, e, w, &
                          present(rates_only) .and. round > 1, defect, band)
        if (.not. defect%known) return
      end do
    end associate
  end subroutine find_defect

  !> The exponent with which the term of order i changes.
  pure complex(wp) function exponent_of(angles, orders, defect, i)
    type(angles_type), intent(in) :: angles
    integer, intent(in) :: orders(:, :), i
    type(defect_type), intent(in) :: defect
    exponent_of = cmplx(sum(abs(orders(:angles%n, i))*angles%growth(:angles%n)), &
                        defect%frequency(i), wp)
  end function exponent_of

  !> Add U and its derivatives at the points of the lattice to y, for all terms at once: Re sum_t
  !! c_t exp(2 pi i t k/n) is Re C + Im D, with the transforms C and D of the real and the imaginary
  !! parts of c.
  subroutine add_waves(angles, step, orders, defect, y)
    type(angles_type), intent(in) :: angles
    integer, intent(in) :: step(:), orders(:, :)
    type(defect_type), intent(in) :: defect
    real(wp), intent(inout) :: y(:, :, 0:)
    complex(wp), dimension(size(y, 1)/2 + 1) :: of_real, of_imaginary
    complex(wp) :: c(0:size(y, 1) - 1), s(defect%n)
    integer :: turn(defect%n), points, i, d, row

    points = size(y, 1)
    do i = 1, defect%n
      turn(i) = modulo(sum(orders(:angles%n, i)*step(:angles%n)), points)
      s(i) = exponent_of(angles, orders, defect, i)
    end do
    do row = 1, size(y, 2)
      do d = 0, 2
        c = (0.0_wp, 0.0_wp)
        do i = 1, defect%n
          c(turn(i)) = c(turn(i)) + 2.0_wp*defect%u(row, i)*s(i)**d
        end do
        call real_spectrum(real(c), of_real)
        call real_spectrum(aimag(c), of_imaginary)
        do i = 1, points/2 + 1
          y(i, row, d) = y(i, row, d) + (real(of_real(i)) + aimag(of_imaginary(i)))
        end do
        do i = points/2 + 2, points
          y(i, row, d) = y(i, row, d) + (real(of_real(points + 2 - i)) &
                                         - aimag(of_imaginary(points + 2 - i)))
        end do
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
  subroutine answer_waves(scales, angles, step, orders, y, e, w, rates_only, defect, band)
    type(multiple_scales_type), intent(in) :: scales
    type(angles_type), intent(in) :: angles
    integer, intent(in) :: step(:), orders(:, :)
    real(wp), intent(in) :: y(:, :, 0:), e(:, :), w(:, :, :)
    !> True: only for the terms near a mode.
    logical, intent(in) :: rates_only
    type(defect_type), intent(inout) :: defect
    real(wp), intent(in), optional :: band
    complex(wp), dimension(size(y, 1)/2 + 1, size(y, 2)) :: of_e, of_slope, of_bend
    complex(wp) :: of_y(size(y, 1)/2 + 1, size(y, 2), 0:2), rates(2*scales%normal%n_generators)
    complex(wp) :: waves(scales%form%n), u(scales%form%n), s
    real(wp) :: slowest, whole(scales%flow%n_modes)
    integer :: points, i, k, d
    logical :: acts(2*scales%normal%n_generators), singular

    points = size(y, 1)
    do k = 1, scales%form%n
      call real_spectrum(e(:, k), of_e(:, k))
      if (.not. scales%form%has_memory()) cycle
      call real_spectrum(w(:, k, 1), of_slope(:, k))
      call real_spectrum(w(:, k, 2), of_bend(:, k))
      do d = 0, 2
        call real_spectrum(y(:, k, d), of_y(:, k, d))
      end do
    end do
    ! A kernel without an integral: the transform at a small s replaces that at 0.
    slowest = 0.0_wp
    if (scales%form%has_memory()) slowest = 1.0e-6_wp*maxval(abs(scales%flow%s))
    whole = scales%flow%frame
    do k = 1, size(whole)
      if (angles%of_mode(k) > 0) whole(k) = angles%whole(angles%of_mode(k))
    end do
    do i = 1, defect%n
      acts = scales%normal%near_modes(defect%frequency(i), whole, band)
      if (rates_only .and. .not. any(acts(:size(whole)))) cycle
      call take_waves()
      s = cmplx(0.0_wp, max(defect%frequency(i), slowest), wp)
      call scales%normal%answer(scales%form, s, -waves, acts, u, rates, singular)
      defect%rates(:, i) = rates(:scales%flow%n_modes)
      ! The stiffness vanishes: there is no finite response.
      if (singular .and. any(abs(waves) > 0.0_wp)) defect%known = .false.
      ! The mean is real: it is not doubled by a conjugate.
      if (all(orders(:, i) == 0)) u = 0.5_wp*u
      defect%u(:, i) = defect%u(:, i) + u
    end do

  contains

    subroutine take_waves()
      complex(wp), dimension(scales%form%n) :: first, second, a_part, retained, slope
      complex(wp) :: at
      integer :: turn, d
      turn = modulo(sum(orders(:angles%n, i)*step(:angles%n)), points)
      waves = wave_of(of_e, turn)
      associate (form => scales%form)
        if (.not. form%has_memory()) return
        at = exponent_of(angles, orders, defect, i)
        at = cmplx(real(at), max(aimag(at), slowest), wp)
        retained = form%retained(at)
        slope = wave_of(of_slope, turn)
        first = slope - at*waves
        second = wave_of(of_bend, turn) - 2.0_wp*at*slope + at**2*waves
        a_part = (0.0_wp, 0.0_wp)
        do d = 0, 2
          a_part = a_part + matmul(form%linear(:, :, d), wave_of(of_y(:, :, d), turn))
        end do
        if (.not. defect%frequency(i) > 0.0_wp) then
          first = (0.0_wp, 0.0_wp)
          second = (0.0_wp, 0.0_wp)
        else
          first = first*form%retained_between([at, at])
          second = second*form%retained_between([at, at, at])
        end if
        where (form%kernel_of > 0) waves = a_part + retained*waves + first + second
      end associate
    end subroutine take_waves

    !> Mean of a signal times exp(-2 pi i turn k/points), of each row.
    pure function wave_of(spectrum, turn) result(wave)
      complex(wp), intent(in) :: spectrum(:, :)
      integer, intent(in) :: turn
      complex(wp) :: wave(size(spectrum, 2))
      if (turn <= points/2) then
        wave = spectrum(turn + 1, :)/points
      else
        wave = conjg(spectrum(points - turn + 1, :))/points
      end if
    end function wave_of

  end subroutine answer_waves

end module viscovib_motion_defect
