!> Derivatives of the equations of harmonic balance with respect to the load factor and the
!! frequency, and derivatives of forces at the samples.
submodule(viscovib_harmonic_balance) balance_slopes
  implicit none

contains

  !> Derivatives of F at the samples.
  module subroutine find_slopes(self, system)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    if (system%moving) then
      call system%moving_slopes(self%u, self%rate, self%w, self%push, self%by_u, self%by_rate, &
                                self%by_v)
    else
      call system%force_slopes(self%u, self%w, self%by_u, self%by_v)
    end if
  end subroutine find_slopes

  !> dR/ds with the load factor s.
  pure module subroutine load_derivative(self, slope)
    class(balance_type), intent(in) :: self
    real(wp), intent(out) :: slope(2*size(self%set%orders), self%n_dof)
    integer :: k
    slope(1::2, :) = -real(self%load)
    slope(2::2, :) = -aimag(self%load)
    if (allocated(self%by_load)) slope = slope + self%by_load
    do k = 1, size(self%set%orders)
      if (self%set%orders(k) == 0) slope(2*k - 1, :) = 0.0_wp
    end do
  end subroutine load_derivative

  !> dR/dnu at the motion x of the last call of `residual`.
  module subroutine frequency_derivative(self, system, load, x, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: x(2*size(self%set%orders), self%n_dof)
    real(wp), intent(out) :: slope(2*size(self%set%orders), self%n_dof)
    complex(wp) :: total(size(self%set%orders), size(x, 2)), y(size(self%set%orders), size(x, 2))
    complex(wp) :: base(size(load%moved, 1), size(load%orders))
    integer :: a, b, k

    total = (0.0_wp, 0.0_wp)
    do b = 1, self%n_dof
      y(:, b) = cmplx(x(1::2, b), x(2::2, b), wp)
    end do
    base = (0.0_wp, 0.0_wp)
    if (load%moves_base()) then
      do k = 1, size(load%orders)
        base(:, k) = load%shift(system, k)
      end do
    end if
    call system%add_frequency_slope(self%set%orders, self%nu, y, load%orders, load%force, base, &
                                    self%load_factor, total)
    if (self%load_varies) total = total - self%load_factor*self%load_slope
    do a = 1, self%n_dof
      slope(1::2, a) = real(total(:, a))
      slope(2::2, a) = aimag(total(:, a))
    end do
    if (any(system%kernel_of > 0)) call add_memory_slope(self, system, y, slope)
    if (size(self%rates) > 0) call add_rate_slope(self, system, slope)
    do k = 1, size(self%cycles)
      if (size(self%rates) > 0) call add_cycle_slope(self, system, self%cycles(k), slope)
    end do
    if (system%moving) call add_moving_slope(self, system, slope)
    if (system%moving .and. self%load_varies) call add_push_slope(self, system, slope)
    do k = 1, size(self%set%orders)
      if (self%set%orders(k) == 0) slope(2*k - 1, :) = 0.0_wp
    end do
  end subroutine frequency_derivative

  !> Add the derivative of F by forces that depend on the frequency, in which F is linear.
  subroutine add_push_slope(self, system, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    real(wp), dimension(size(self%u, 1), self%n_dof) :: push, f, without
    integer :: b

    do b = 1, self%n_dof
      self%kept(1::2) = self%load_factor*real(self%load_slope(:, b))
      self%kept(2::2) = self%load_factor*aimag(self%load_slope(:, b))
      call self%tables%to_samples(self%kept, push(:, b))
    end do
    call system%moving_remainder(self%u, self%rate, self%w, push, f)
    call system%moving_remainder(self%u, self%rate, self%w, 0.0_wp*push, without)
    do b = 1, self%n_dof
      call self%tables%to_parts(f(:, b) - without(:, b), self%f_parts)
      slope(:, b) = slope(:, b) + self%f_parts
    end do
  end subroutine add_push_slope

  !> Add the derivative of a law that is not a polynomial.
  subroutine add_cycle_slope(self, system, one, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(cycle_term), intent(inout) :: one
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    type(law_term), pointer :: law
    integer :: a, j

    call find_blocks(one, system, self%set, self%tables, self%nu)
    law => law_of(one, system)
    do j = 1, size(law%variables)
      associate (v => law%variables(j))
        self%kept = law%weights(j)*one%by_nu
        if (system%kernel_of(v) > 0) call retain(self%fraction(:, v), self%kept)
        do a = 1, self%n_dof
          slope(:, a) = slope(:, a) + system%spread(a, v)*self%kept
        end do
      end associate
    end do
  end subroutine add_cycle_slope

  !> Add the contribution of the rates in laws, which are proportional to nu.
  subroutine add_rate_slope(self, system, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    real(wp) :: samples(size(self%u, 1))
    integer :: a, b, j

    if (.not. self%bent_known) call system%sampled_slopes(self%u, self%slopes)
    self%bent_known = .true.
    do j = 1, self%n_memory
      if (.not. system%bent(j)) cycle
      samples = 0.0_wp
      do b = 1, size(self%rates)
        samples = samples + self%slopes(:, j, self%n_dof + b)*self%u(:, self%n_dof + b)
      end do
      call self%tables%to_parts(samples/self%nu, self%kept)
      if (system%kernel_of(j) > 0) call retain(self%fraction(:, j), self%kept)
      do a = 1, self%n_dof
        slope(:, a) = slope(:, a) + system%spread(a, j)*self%kept
      end do
    end do
  end subroutine add_rate_slope

  !> Add the contribution of the rates in F.
  subroutine add_moving_slope(self, system, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    real(wp) :: samples(size(self%u, 1))
    integer :: a, b

    call find_slopes(self, system)
    do a = 1, self%n_dof
      samples = 0.0_wp
      do b = 1, self%n_dof
        samples = samples + self%by_rate(:, a, b)*self%rate(:, b)/self%nu
      end do
      call self%tables%to_parts(samples, self%f_parts)
      slope(:, a) = slope(:, a) + self%f_parts
    end do
  end subroutine add_moving_slope

  !> Add the contribution of memory: dv_k/dnu = k f'(k nu) W_k, in B v and in F(u, v) - B v at the
  !! samples.
  subroutine add_memory_slope(self, system, y, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: y(size(self%set%orders), self%n_dof)
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    complex(wp) :: by_nu(size(self%set%orders), self%n_memory), v(size(self%set%orders))
    real(wp) :: samples(size(self%u, 1))
    integer :: a, j

    call system%retained_slope(self%set%orders*self%nu, self%fraction, by_nu)
    if (.not. system%separable) call find_slopes(self, system)
    do j = 1, self%n_memory
      if (system%kernel_of(j) == 0) cycle
      v = self%set%orders*by_nu(:, j)*(cmplx(self%bent(1::2, j), self%bent(2::2, j), wp) &
                                       + matmul(y, system%gather(j, :)))
      self%kept(1::2) = real(v)
      self%kept(2::2) = aimag(v)
      do a = 1, self%n_dof
        slope(:, a) = slope(:, a) + system%spread(a, j)*self%kept
      end do
      if (system%separable) cycle
      call self%tables%to_samples(self%kept, samples)
      do a = 1, self%n_dof
        if (.not. any(abs(self%by_v(:, a, j)) > 0.0_wp)) cycle
        call self%tables%to_parts(self%by_v(:, a, j)*samples, self%f_parts)
        slope(:, a) = slope(:, a) + self%f_parts
      end do
    end do
  end subroutine add_memory_slope

end submodule balance_slopes
